"""Meshes in plan view: how far a place is from what a body would hit, for the robot, for people and for free space.

A body hits the triangles' parts between two heights, seen from above: the same triangles that the rays meet. Inside a
solid, or below or above a surface at those heights, the distance is 0.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from densecavoid.sim._jit import inner, kernel
from densecavoid.sim.mesh import (
    PLACE_COS,
    PLACE_NUMBER,
    PLACE_SIN,
    PLACE_X,
    PLACE_Y,
    PLACE_Z,
    MeshPlace,
    mesh_set,
    place_rows,
)
from densecavoid.sim.people import ABSENT, STANDING, STEP_OVER_M, WALK_UNDER_M

GROUND_M = 0.02
"""What is lower is ground that one rolls or walks over: a scanned room's floor is no obstacle."""
_PEOPLE = (STEP_OVER_M, WALK_UNDER_M)
_FORCE = 3.0  # m/s2 on a person at the surface, falling with distance as that of walls (crowds)
_FORCE_RANGE_M = 0.15
FORCE_REACH_M = 0.6
_RELAXATION_S = 0.5  # in which people take on the velocity they intend
_DIRECTIONS = 16
_RINGS = 6  # the nearest of .1 m, each twice as wide as the one before


@inner
def _nearer_on_segment(best, x, y, ax, ay, bx, by):
    """`best` (squared distance, offset x, y) or what a segment offers instead."""
    along_x, along_y = bx - ax, by - ay
    length_2 = along_x * along_x + along_y * along_y
    s = ((x - ax) * along_x + (y - ay) * along_y) / length_2 if length_2 > 0.0 else 0.0
    s = min(max(s, 0.0), 1.0)
    off_x, off_y = x - ax - s * along_x, y - ay - s * along_y
    distance_2 = off_x * off_x + off_y * off_y
    return (distance_2, off_x, off_y) if distance_2 < best[0] else best


@inner
def _nearer_on_triangle(best, x, y, all_corners, triangle, low, high):
    """The same for the part of a triangle [3, 3] between two heights, its inner area left out; also its height there.

    Returns:
        (best, height of the triangle over the point or NaN, 1 if it looks up and -1 if down)
    """
    corners = all_corners[triangle]
    low_x, low_y, high_x, high_y = np.nan, np.nan, np.nan, np.nan
    crossings = 0
    for v in range(3):
        ax, ay, az = float(corners[v, 0]), float(corners[v, 1]), float(corners[v, 2])
        w = (v + 1) % 3
        bx, by, bz = float(corners[w, 0]), float(corners[w, 1]), float(corners[w, 2])
        # Whether the half-line from the point along x crosses the edge: the same answer for both triangles at an edge.
        if (ay > y) != (by > y):
            swap = ay > by
            x0, y0, x1, y1 = (bx, by, ax, ay) if swap else (ax, ay, bx, by)
            if x < x0 + (y - y0) * (x1 - x0) / (y1 - y0):
                crossings += 1
        enter, leave = 0.0, 1.0
        if az != bz:
            at_low, at_high = (low - az) / (bz - az), (high - az) / (bz - az)
            enter, leave = max(0.0, min(at_low, at_high)), min(1.0, max(at_low, at_high))
            # The cuts at the two heights are edges of the part, too.
            if 0.0 <= at_low <= 1.0:
                cut_x, cut_y = ax + at_low * (bx - ax), ay + at_low * (by - ay)
                if math.isnan(low_x):
                    low_x, low_y = cut_x, cut_y
                best = _nearer_on_segment(best, x, y, low_x, low_y, cut_x, cut_y)
            if 0.0 <= at_high <= 1.0:
                cut_x, cut_y = ax + at_high * (bx - ax), ay + at_high * (by - ay)
                if math.isnan(high_x):
                    high_x, high_y = cut_x, cut_y
                best = _nearer_on_segment(best, x, y, high_x, high_y, cut_x, cut_y)
        elif az < low or az > high:
            enter = 2.0
        if enter <= leave:
            from_x, from_y = ax + enter * (bx - ax), ay + enter * (by - ay)
            best = _nearer_on_segment(best, x, y, from_x, from_y, ax + leave * (bx - ax), ay + leave * (by - ay))
    if crossings != 1:
        return best, np.nan, 0
    ax, ay, az = float(corners[0, 0]), float(corners[0, 1]), float(corners[0, 2])
    px, py, pz = corners[1, 0] - ax, corners[1, 1] - ay, corners[1, 2] - az
    qx, qy, qz = corners[2, 0] - ax, corners[2, 1] - ay, corners[2, 2] - az
    normal_x, normal_y, normal_z = py * qz - pz * qy, pz * qx - px * qz, px * qy - py * qx
    if normal_z == 0.0:
        return best, np.nan, 0
    return best, az - (normal_x * (x - ax) + normal_y * (y - ay)) / normal_z, 1 if normal_z > 0.0 else -1


@inner
def _box_distance_2(x, y, meshes, node):
    """Squared distance in plan view from a point to a box of the hierarchy."""
    low, high = meshes.node_low[node], meshes.node_high[node]
    off_x, off_y = max(low[0] - x, x - high[0], 0.0), max(low[1] - y, y - high[1], 0.0)
    return off_x * off_x + off_y * off_y


@kernel
def nearest_mesh(x, y, low, top, limit, places, meshes):
    """How far a world point is from what placed meshes [M, 6] have between two heights, and the way off it.

    Returns:
        (distance, offset x, offset y), the offset from the nearest point of a mesh to the given one. All 0 on or inside
        of one; (limit, 0, 0) if none is nearer than `limit`.
    """
    offset_x, offset_y = 0.0, 0.0
    for m in range(places.shape[0]):
        place = places[m]
        k = int(place[PLACE_NUMBER])
        cos, sin = place[PLACE_COS], place[PLACE_SIN]
        rel_x, rel_y = x - place[PLACE_X], y - place[PLACE_Y]
        at_x, at_y = cos * rel_x + sin * rel_y, cos * rel_y - sin * rel_x
        lowest, highest = low - place[PLACE_Z], top - place[PLACE_Z]
        solid = meshes.solid[k]
        best = (limit * limit, 0.0, 0.0)
        within = 0  # solids around the point at the lowest height, by the surfaces above it
        root, base = meshes.first_node[k], meshes.first_triangle[k]
        # First down to the triangles in the nearer halves: they make most others needless. Then through all.
        node, end, first_look = root, meshes.first_node[k + 1], True
        while node < end:
            bottom, peak = meshes.node_low[node, 2], meshes.node_high[node, 2]
            distance_2 = _box_distance_2(at_x, at_y, meshes, node)
            above = solid and distance_2 == 0.0 and peak > highest
            needless = peak < lowest or ((bottom > highest or distance_2 >= best[0]) and not above)
            if not needless and meshes.node_count[node] == 0:
                node += 1
                other = root + meshes.node_skip[node]
                if first_look and _box_distance_2(at_x, at_y, meshes, other) < _box_distance_2(
                    at_x, at_y, meshes, node
                ):
                    node = other
                continue
            if not needless:
                first = base + meshes.node_first[node]
                for triangle in range(first, first + meshes.node_count[node]):
                    best, height, facing = _nearer_on_triangle(
                        best, at_x, at_y, meshes.corners, triangle, lowest, highest
                    )
                    if height > highest:
                        within += facing
                    elif height >= lowest:
                        return 0.0, 0.0, 0.0
            if first_look:
                node, first_look, within = root, False, 0
            else:
                node = root + meshes.node_skip[node]
        if within > 0:
            return 0.0, 0.0, 0.0
        if best[0] < limit * limit:
            limit = math.sqrt(best[0])
            offset_x, offset_y = cos * best[1] - sin * best[2], sin * best[1] + cos * best[2]
    return limit, offset_x, offset_y


@kernel
def _lessen(points, low, top, places, meshes, clearances):
    for n in range(points.shape[0]):
        clearances[n], _, _ = nearest_mesh(points[n, 0], points[n, 1], low, top, clearances[n], places, meshes)


def lessen_by_meshes(placed: Sequence[MeshPlace], points: np.ndarray, low: float, top: float, clearances: np.ndarray):
    """Lessens clearances [N] of points [N, 2] to their distances from what meshes have between two heights (m)."""
    if placed:
        meshes = tuple(dict.fromkeys(place.mesh for place in placed))
        places = place_rows(placed, [meshes.index(place.mesh) for place in placed])
        _lessen(points, max(low, GROUND_M), top, places, mesh_set(meshes), clearances)


@inner
def _way_out(x, y, places, meshes):
    """From a place inside of a mesh, the step to the nearest of some places around it that are not."""
    for k in range(_RINGS * _DIRECTIONS):
        reach, bearing = 0.1 * 2.0 ** (k // _DIRECTIONS), k % _DIRECTIONS * 2.0 * math.pi / _DIRECTIONS
        step_x, step_y = reach * math.cos(bearing), reach * math.sin(bearing)
        if nearest_mesh(x + step_x, y + step_y, *_PEOPLE, 1e-3, places, meshes)[0] > 0.0:
            return step_x, step_y
    return 0.0, 0.0


@inner
def part_people_from_meshes(state, b, meshes, intended, reach):
    """Keeps the people of world b off meshes as off walls.

    Args:
        intended: [P, 2] what people intend; gets the velocity that leads away from meshes near them.
        reach: how far from their bodies meshes lead them away; 0: instead, who touches a mesh is moved off it.
    """
    places = state.meshes[b, : state.num_meshes[b]]
    if places.shape[0] == 0:
        return
    for i in range(state.pos.shape[1]):
        if state.behaviour[b, i] == ABSENT or state.behaviour[b, i] == STANDING:
            continue
        x, y, radius = state.pos[b, i, 0], state.pos[b, i, 1], state.radius[b, i]
        limit = radius + reach
        distance, off_x, off_y = nearest_mesh(x, y, *_PEOPLE, limit, places, meshes)
        if distance >= limit:
            continue
        if reach > 0.0:
            size = _RELAXATION_S * _FORCE * math.exp(-(distance - radius) / _FORCE_RANGE_M) / max(distance, 1e-6)
            intended[i, 0] += size * off_x
            intended[i, 1] += size * off_y
        elif distance > 0.0:
            state.pos[b, i, 0] += (radius - distance) * off_x / distance
            state.pos[b, i, 1] += (radius - distance) * off_y / distance
        else:
            off_x, off_y = _way_out(x, y, places, meshes)
            state.pos[b, i, 0] += off_x
            state.pos[b, i, 1] += off_y
