"""ORCA people (van den Berg, Guy, Lin, Manocha, ISRR 2011): optimal reciprocal collision avoidance of discs.

Each neighbour and each near thing forbids a half plane of velocities; a linear program finds the allowed velocity
nearest to the wished one, or, where there is none, the one that breaks the constraints least. Things are never broken.
A thing's half plane is that of its nearest point, which for a straight wall is exact.
"""

from __future__ import annotations

import math

import numpy as np

from densecavoid.sim._jit import inner, kernel
from densecavoid.sim.crowds.neighbours import MAX_THINGS, collect, thing_offset, walks
from densecavoid.sim.people import YIELD

NEIGHBOURS = 10
"""So many of the nearest people are thought of (the usual choice of the method's authors), and the robot."""
HORIZON_S = 2.0
"""Collisions with people within this time are avoided,"""
THING_HORIZON_S = 1.0
"""and with things within this time."""
SIGHT_M = 5.0
_OVERSPEED = 1.3
_PARALLEL = 1e-9


@kernel
def avoid_disc(off_x, off_y, approach_x, approach_y, reach, horizon_s, dt):
    """The smallest change of relative velocity that avoids a disc, and the outward unit normal there.

    Args:
        off_x, off_y: to the other's centre.
        approach_x, approach_y: own velocity minus the other's.
        reach: distance of the centres at which they touch.
    """
    distance_2 = off_x * off_x + off_y * off_y
    time_s = horizon_s if distance_2 > reach * reach else dt  # who overlaps comes apart within a step
    from_x, from_y = approach_x - off_x / time_s, approach_y - off_y / time_s
    length = math.sqrt(from_x * from_x + from_y * from_y)
    inward = from_x * off_x + from_y * off_y
    if distance_2 <= reach * reach or (inward < 0.0 and inward * inward > reach * reach * length * length):
        # The velocity is nearest to the round front of the cone.
        if length < 1e-9:
            distance = max(math.sqrt(distance_2), 1e-9)
            from_x, from_y, length = -off_x / distance, -off_y / distance, 1.0
            return reach / time_s * from_x, reach / time_s * from_y, from_x, from_y
        normal_x, normal_y = from_x / length, from_y / length
        change = reach / time_s - length
        return change * normal_x, change * normal_y, normal_x, normal_y
    # It is nearest to one of the cone's sides, which touch the disc.
    leg = math.sqrt(distance_2 - reach * reach)
    side = 1.0 if off_x * from_y - off_y * from_x > 0.0 else -1.0
    along_x = (off_x * leg - side * off_y * reach) / distance_2
    along_y = (side * off_x * reach + off_y * leg) / distance_2
    normal_x, normal_y = -side * along_y, side * along_x
    change = -(approach_x * normal_x + approach_y * normal_y)
    return change * normal_x, change * normal_y, normal_x, normal_y


@kernel
def _on_line(planes, k, limit, wish_x, wish_y, best, farthest):
    """The allowed velocity on plane k's edge, given the planes before it, into `best`; False if there is none.

    Planes are rows (point x, y, inward normal x, y).
    """
    px, py, nx, ny = planes[k, 0], planes[k, 1], planes[k, 2], planes[k, 3]
    tx, ty = ny, -nx
    along = px * tx + py * ty
    discriminant = along * along + limit * limit - px * px - py * py
    if discriminant < 0.0:
        return False
    root = math.sqrt(discriminant)
    low, high = -along - root, -along + root
    for j in range(k):
        slope = tx * planes[j, 2] + ty * planes[j, 3]
        missing = (planes[j, 0] - px) * planes[j, 2] + (planes[j, 1] - py) * planes[j, 3]
        if abs(slope) <= _PARALLEL:
            if missing > 0.0:
                return False
            continue
        if slope > 0.0:
            low = max(low, missing / slope)
        else:
            high = min(high, missing / slope)
        if low > high:
            return False
    if farthest:
        t = high if wish_x * tx + wish_y * ty > 0.0 else low
    else:
        t = min(max((wish_x - px) * tx + (wish_y - py) * ty, low), high)
    best[0], best[1] = px + t * tx, py + t * ty
    return True


@kernel
def _solve(planes, count, limit, wish_x, wish_y, best, farthest):
    """The allowed velocity nearest to the wish (or farthest its way) into `best`; the first plane that failed."""
    length = math.sqrt(wish_x * wish_x + wish_y * wish_y)
    scale = limit / length if farthest or length > limit else 1.0
    best[0], best[1] = wish_x * scale, wish_y * scale
    for k in range(count):
        if (best[0] - planes[k, 0]) * planes[k, 2] + (best[1] - planes[k, 1]) * planes[k, 3] < 0.0:
            before_x, before_y = best[0], best[1]
            if not _on_line(planes, k, limit, wish_x, wish_y, best, farthest):
                best[0], best[1] = before_x, before_y
                return k
    return count


@kernel
def nearest_velocity(planes, count, hard, limit, wish_x, wish_y, best):
    """The velocity of at most `limit` in all half planes that is nearest to the wish, into `best` [2].

    Where there is none, the one that goes least beyond any of them; the first `hard` ones are kept all the same.

    Args:
        planes: [count or more, 4] rows (point x, y, inward unit normal x, y).
    """
    failed = _solve(planes, count, limit, wish_x, wish_y, best, False)
    if failed == count:
        return
    edges = np.empty((count, 4))
    edges[:hard] = planes[:hard]
    worst = 0.0
    for k in range(max(failed, hard), count):
        px, py, nx, ny = planes[k, 0], planes[k, 1], planes[k, 2], planes[k, 3]
        if (px - best[0]) * nx + (py - best[1]) * ny <= worst:
            continue
        # Among velocities that break plane k no more than any plane before it, the one that breaks k least.
        size = hard
        for j in range(hard, k):
            qx, qy, mx, my = planes[j, 0], planes[j, 1], planes[j, 2], planes[j, 3]
            turn = nx * my - ny * mx
            if abs(turn) <= _PARALLEL:
                if nx * mx + ny * my > 0.0:
                    continue
                ex, ey = 0.5 * (px + qx), 0.5 * (py + qy)
            else:  # where the two edges meet
                t = ((qx - px) * mx + (qy - py) * my) / (ny * mx - nx * my)
                ex, ey = px + t * ny, py - t * nx
            ox, oy = mx - nx, my - ny
            length = max(math.sqrt(ox * ox + oy * oy), 1e-9)
            edges[size, 0], edges[size, 1], edges[size, 2], edges[size, 3] = ex, ey, ox / length, oy / length
            size += 1
        before_x, before_y = best[0], best[1]
        if _solve(edges, size, limit, nx, ny, best, True) < size:
            best[0], best[1] = before_x, before_y
        worst = (px - best[0]) * nx + (py - best[1]) * ny


@inner
def _nearest_first(scene, x, y, scratch, count):
    """Brings the nearest people to the front of `scratch.near`; how many are thought of."""
    kept = min(count, NEIGHBOURS)
    for n in range(kept):
        least, at = np.inf, n
        for m in range(n, count):
            off_x, off_y = scene.pos[scratch.near[m], 0] - x, scene.pos[scratch.near[m], 1] - y
            if off_x * off_x + off_y * off_y < least:
                least, at = off_x * off_x + off_y * off_y, m
        scratch.near[n], scratch.near[at] = scratch.near[at], scratch.near[n]
    return kept


@kernel
def choose_velocities(scene, scratch, dt):
    """Writes the velocities into `scratch.velocity` with which everybody goes on."""
    planes, best = np.empty((MAX_THINGS + NEIGHBOURS + 1, 4)), np.empty(2)
    for i in range(len(scene.pos)):
        if not walks(scene.behaviour[i]):
            continue
        x, y, vx, vy, radius = scene.pos[i, 0], scene.pos[i, 1], scene.vel[i, 0], scene.vel[i, 1], scene.radius[i]
        hard = min(scratch.num_things[i], MAX_THINGS)
        for n in range(hard):
            distance, normal_x, normal_y = thing_offset(x, y, scene.boxes, scene.pillars, scratch.things[i, n])
            inward = -(distance - radius) / THING_HORIZON_S
            planes[n, 0], planes[n, 1], planes[n, 2], planes[n, 3] = (
                inward * normal_x,
                inward * normal_y,
                normal_x,
                normal_y,
            )
        count = hard
        near = _nearest_first(scene, x, y, scratch, collect(i, x, y, scratch, SIGHT_M))
        for n in range(near + 1):
            share = 0.5  # of the avoiding that this person does
            if n < near:
                j = scratch.near[n]
                off_x, off_y, reach = scene.pos[j, 0] - x, scene.pos[j, 1] - y, radius + scene.radius[j]
                to_x, to_y = scene.vel[j, 0], scene.vel[j, 1]
            elif scene.attitude[i] >= YIELD:
                off_x, off_y, reach = scene.robot[0] - x, scene.robot[1] - y, radius + scene.robot[4]
                to_x, to_y = scene.robot[2], scene.robot[3]
            else:
                break
            if n == near or not walks(scene.behaviour[scratch.near[n]]):
                share = 1.0
            cx, cy, nx, ny = avoid_disc(off_x, off_y, vx - to_x, vy - to_y, reach, HORIZON_S, dt)
            planes[count, 0], planes[count, 1] = vx + share * cx, vy + share * cy
            planes[count, 2], planes[count, 3] = nx, ny
            count += 1
        limit = _OVERSPEED * scene.preferred_speed[i]
        nearest_velocity(planes, count, hard, limit, scratch.intended[i, 0], scratch.intended[i, 1], best)
        scratch.velocity[i, 0], scratch.velocity[i, 1] = best[0], best[1]
