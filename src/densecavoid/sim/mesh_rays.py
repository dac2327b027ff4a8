"""Rays against triangle meshes: for a lidar and for a depth camera, all rays of the sensor at once.

The bounding hierarchy is walked once for each sensor, not for each ray: what the whole sensor cannot meet is left out,
and each triangle that remains is met with the few rays that pass by it. A ray d from the origin passes inside a
triangle a, b, c if d.(a x b), d.(b x c) and d.(c x a) have one sign; it ends at t = n.a / n.d with
n = (b - a) x (c - a). Distances are raw: the sensors' limits are applied elsewhere.
"""

from __future__ import annotations

import math

import numpy as np

from densecavoid.sim._jit import inner, kernel
from densecavoid.sim.mesh import PLACE_COS, PLACE_NUMBER, PLACE_SIN, PLACE_X, PLACE_Y, PLACE_Z

_ROUNDING = 2e-7  # of float32 products: rays that pass so near to an edge belong to both of its triangles
_NEAR_M = 1e-3  # what is nearer to a camera's plane than this has no place on the image


@inner
def _circle_position(x, y):
    """Where a direction is on the circle: grows with its bearing from -2 to 2, opposite directions are 2 apart."""
    size = abs(x) + abs(y)
    along = 1.0 - x / size if size > 0.0 else 0.0
    return along if y >= 0.0 else -along


@inner
def _apart(position, other):
    """The way from one position on the circle to another, -2 to 2."""
    way = other - position
    return way - 4.0 if way > 2.0 else (way + 4.0 if way < -2.0 else way)


@inner
def _first_from(position, value):
    """The first ray at a position on the circle or beyond it."""
    first, last = 0, position.shape[0]
    while first < last:
        middle = (first + last) // 2
        if position[middle] < value:
            first = middle + 1
        else:
            last = middle
    return first


@inner
def _cross(out, a, b):
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@inner
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inner
def _edges(corner, edge, passing, normal):
    """A triangle's edges, the planes through origin and edge (rows of `passing`) and its normal; returns n.a."""
    for k in range(3):
        following = corner[(k + 1) % 3]
        for axis in range(3):
            edge[k, axis] = following[axis] - corner[k, axis]
        _cross(passing[k], corner[k], edge[k])
    _cross(normal, edge[0], edge[1])
    return _dot(normal, corner[0])


@inner
def _slack(passing):
    return np.float32(_ROUNDING * (abs(passing[0]) + abs(passing[1]) + abs(passing[2])))


@kernel
def mesh_scan(
    ranges, hits, first_hit_number, x, y, z, yaw, dir_x, dir_y, dir_z, start_x, start_y, max_range, places, meshes
):
    """Shortens `ranges` [rays] where a mesh is nearer.

    Args:
        ranges: raw distances so far; inf where nothing is met.
        hits: i32 [rays], gets `first_hit_number` + the number of the triangle met (counted through all `places`, see
            `triangle_of_hit`); of length 0 if nobody wants to know.
        x, y, z, yaw: the scanner in the world.
        dir_x, dir_y, dir_z: f32 [rays] unit directions turned by `yaw`, in order of their bearing, counter-clockwise.
        start_x, start_y: f32 [rays] where each ray starts, from (x, y) and turned by `yaw` too, for a scanner in
            motion; of length 0 if all start there.
        places: f64 [M, 6] (mesh.PLACE_...), meshes: the `MeshSet` they are numbered in.
    """
    num_rays = ranges.shape[0]
    if hits.shape[0] == 0:
        hits = np.empty(num_rays, np.int32)
    if start_x.shape[0] == 0:
        start_x = start_y = np.zeros(num_rays, np.float32)
    # The plane that the rays lie in (a scanner's do, whatever its pitch), and how far any ray leaves it.
    position, plane = np.empty(num_rays), np.empty(3)
    i, j = num_rays // 3, 2 * num_rays // 3
    plane[0] = dir_y[i] * dir_z[j] - dir_z[i] * dir_y[j]
    plane[1] = dir_z[i] * dir_x[j] - dir_x[i] * dir_z[j]
    plane[2] = dir_x[i] * dir_y[j] - dir_y[i] * dir_x[j]
    length = math.sqrt(_dot(plane, plane))
    plane *= 1.0 / length if length > 1e-6 else 0.0  # without a plane nothing is left out for its height
    shift, leaves = 0.0, 0.0
    for r in range(num_rays):
        shift = max(shift, math.sqrt(start_x[r] * start_x[r] + start_y[r] * start_y[r]))
        out_of_plane = abs(plane[0] * dir_x[r] + plane[1] * dir_y[r] + plane[2] * dir_z[r])
        leaves = max(leaves, out_of_plane * max_range + abs(plane[0] * start_x[r] + plane[1] * start_y[r]))
        position[r] = _circle_position(float(dir_x[r]), float(dir_y[r]))
    leaves += 1e-5
    middle = num_rays // 2
    for r in range(middle + 1, num_rays):
        position[r] = position[r - 1] + _apart(position[r - 1], position[r])
    for r in range(middle - 1, -1, -1):
        position[r] = position[r + 1] + _apart(position[r + 1], position[r])
    corner, edge, passing = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    normal, local_plane = np.empty(3), np.empty(3)
    cos, sin = math.cos(yaw), math.sin(yaw)
    number = first_hit_number
    for m in range(places.shape[0]):
        place = places[m]
        k = int(place[PLACE_NUMBER])
        # The scanner in the mesh's frame; a direction there is one here turned by (turn_cos, turn_sin).
        rel_x, rel_y = x - place[PLACE_X], y - place[PLACE_Y]
        at_x = place[PLACE_COS] * rel_x + place[PLACE_SIN] * rel_y
        at_y = place[PLACE_COS] * rel_y - place[PLACE_SIN] * rel_x
        at_z = z - place[PLACE_Z]
        turn_cos = cos * place[PLACE_COS] + sin * place[PLACE_SIN]
        turn_sin = sin * place[PLACE_COS] - cos * place[PLACE_SIN]
        local_plane[0] = turn_cos * plane[0] - turn_sin * plane[1]
        local_plane[1] = turn_sin * plane[0] + turn_cos * plane[1]
        local_plane[2] = plane[2]
        root, base = meshes.first_node[k], meshes.first_triangle[k]
        node, end = root, meshes.first_node[k + 1]
        while node < end:
            low, high = meshes.node_low[node], meshes.node_high[node]
            mid_x = 0.5 * (low[0] + high[0]) - at_x
            mid_y = 0.5 * (low[1] + high[1]) - at_y
            mid_z = 0.5 * (low[2] + high[2]) - at_z
            half_x, half_y, half_z = 0.5 * (high[0] - low[0]), 0.5 * (high[1] - low[1]), 0.5 * (high[2] - low[2])
            off_x, off_y = max(abs(mid_x) - half_x, 0.0), max(abs(mid_y) - half_y, 0.0)
            off_plane = abs(local_plane[0] * mid_x + local_plane[1] * mid_y + local_plane[2] * mid_z)
            half_plane = abs(local_plane[0]) * half_x + abs(local_plane[1]) * half_y + abs(local_plane[2]) * half_z
            reach = max_range + shift
            if off_x * off_x + off_y * off_y > reach * reach or off_plane > half_plane + leaves:
                node = root + meshes.node_skip[node]
                continue
            margin = 1e-6 + (1.6 * shift + 1e-6) / max(math.sqrt(off_x * off_x + off_y * off_y), 1e-9)
            first_triangle = base + meshes.node_first[node]
            for triangle in range(first_triangle, first_triangle + meshes.node_count[node]):
                below, above = np.inf, -np.inf
                for v in range(3):
                    vertex = meshes.corners[triangle, v]
                    rel_x, rel_y, rel_z = vertex[0] - at_x, vertex[1] - at_y, vertex[2] - at_z
                    corner[v, 0] = turn_cos * rel_x + turn_sin * rel_y
                    corner[v, 1] = turn_cos * rel_y - turn_sin * rel_x
                    corner[v, 2] = rel_z
                    height = _dot(plane, corner[v])
                    below, above = min(below, height), max(above, height)
                if below > leaves or above < -leaves:
                    continue
                depth = _edges(corner, edge, passing, normal)
                # The triangle's part of the circle; all of it around or right beside the scanner.
                start, right, left = 0.0, 0.0, 0.0
                for v in range(3):
                    at = _circle_position(corner[v, 0], corner[v, 1])
                    start = at if v == 0 else start
                    way = _apart(start, at)
                    right, left = min(right, way), max(left, way)
                if left - right + 2.0 * margin >= 2.0 - 1e-6:
                    right, left = position[0], position[-1] + 1e-6
                else:
                    right, left = start + right - margin, start + left + margin
                while right > position[0]:
                    right, left = right - 4.0, left - 4.0
                p0, p1, p2 = passing[0], passing[1], passing[2]
                slack_0, slack_1, slack_2 = _slack(p0), _slack(p1), _slack(p2)
                p0x, p0y, p0z = np.float32(p0[0]), np.float32(p0[1]), np.float32(p0[2])
                p1x, p1y, p1z = np.float32(p1[0]), np.float32(p1[1]), np.float32(p1[2])
                p2x, p2y, p2z = np.float32(p2[0]), np.float32(p2[1]), np.float32(p2[2])
                e0x, e0y, e0z = np.float32(edge[0, 0]), np.float32(edge[0, 1]), np.float32(edge[0, 2])
                e1x, e1y, e1z = np.float32(edge[1, 0]), np.float32(edge[1, 1]), np.float32(edge[1, 2])
                e2x, e2y, e2z = np.float32(edge[2, 0]), np.float32(edge[2, 1]), np.float32(edge[2, 2])
                nx, ny, nz, depth_32 = (
                    np.float32(normal[0]),
                    np.float32(normal[1]),
                    np.float32(normal[2]),
                    np.float32(depth),
                )
                which = np.int32(number + triangle - base)
                while right <= position[-1]:
                    first, last = _first_from(position, right), _first_from(position, left)
                    right, left = right + 4.0, left + 4.0
                    for r in range(first, last):
                        dx, dy, dz, sx, sy = dir_x[r], dir_y[r], dir_z[r], start_x[r], start_y[r]
                        # The ray's moment, start x direction, is what its start changes.
                        mx, my, mz = sy * dz, -sx * dz, sx * dy - sy * dx
                        u = p0x * dx + p0y * dy + p0z * dz + e0x * mx + e0y * my + e0z * mz
                        v = p1x * dx + p1y * dy + p1z * dz + e1x * mx + e1y * my + e1z * mz
                        w = p2x * dx + p2y * dy + p2z * dz + e2x * mx + e2y * my + e2z * mz
                        t = (depth_32 - nx * sx - ny * sy) / (nx * dx + ny * dy + nz * dz)
                        inside = (u >= -slack_0) & (v >= -slack_1) & (w >= -slack_2)
                        inside |= (u <= slack_0) & (v <= slack_1) & (w <= slack_2)
                        nearer = inside & (t > np.float32(0.0)) & (t < ranges[r])
                        ranges[r] = t if nearer else ranges[r]
                        hits[r] = which if nearer else hits[r]
            node = root + meshes.node_skip[node] if meshes.node_count[node] > 0 else node + 1
        number += meshes.first_triangle[k + 1] - base


@kernel
def mesh_depth(image, hits, first_hit_number, x, y, z, yaw, column_slope, row_slope, pitch, max_range, places, meshes):
    """Lessens the depths of `image` [height, width] where a mesh is nearer.

    Args:
        image: raw depths along the optical axis so far; inf where nothing is met.
        hits: i32 [height, width] as in `mesh_scan`; without rows if nobody wants to know.
        x, y, z, yaw, pitch: the camera in the world (pitch down).
        column_slope, row_slope: f32, evenly spaced, of each column to the left and of each row upwards.
        places: f64 [M, 6] (mesh.PLACE_...), meshes: the `MeshSet` they are numbered in.
    """
    rows, columns = image.shape
    if hits.shape[0] == 0:
        hits = np.empty((rows, columns), np.int32)
    to_left, to_right, up, down = column_slope[0], column_slope[-1], row_slope[0], row_slope[-1]
    per_column, per_row = (columns - 1) / (to_left - to_right), (rows - 1) / (up - down)
    corner, edge, passing, normal = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    # The camera's axes (forward, left, up), and the inner normals of the view's four sides, in the mesh's frame.
    axes, sides = np.empty((3, 3)), np.empty((4, 3))
    cos_pitch, sin_pitch = math.cos(pitch), math.sin(pitch)
    number = first_hit_number
    for m in range(places.shape[0]):
        place = places[m]
        k = int(place[PLACE_NUMBER])
        rel_x, rel_y = x - place[PLACE_X], y - place[PLACE_Y]
        at_x = place[PLACE_COS] * rel_x + place[PLACE_SIN] * rel_y
        at_y = place[PLACE_COS] * rel_y - place[PLACE_SIN] * rel_x
        at_z = z - place[PLACE_Z]
        cos = math.cos(yaw) * place[PLACE_COS] + math.sin(yaw) * place[PLACE_SIN]
        sin = math.sin(yaw) * place[PLACE_COS] - math.cos(yaw) * place[PLACE_SIN]
        axes[0, 0], axes[0, 1], axes[0, 2] = cos * cos_pitch, sin * cos_pitch, -sin_pitch
        axes[1, 0], axes[1, 1], axes[1, 2] = -sin, cos, 0.0
        axes[2, 0], axes[2, 1], axes[2, 2] = cos * sin_pitch, sin * sin_pitch, cos_pitch
        for axis in range(3):
            sides[0, axis] = to_left * axes[0, axis] - axes[1, axis]
            sides[1, axis] = axes[1, axis] - to_right * axes[0, axis]
            sides[2, axis] = up * axes[0, axis] - axes[2, axis]
            sides[3, axis] = axes[2, axis] - down * axes[0, axis]
        root, base = meshes.first_node[k], meshes.first_triangle[k]
        node, end = root, meshes.first_node[k + 1]
        while node < end:
            low, high = meshes.node_low[node], meshes.node_high[node]
            mid_x = 0.5 * (low[0] + high[0]) - at_x
            mid_y = 0.5 * (low[1] + high[1]) - at_y
            mid_z = 0.5 * (low[2] + high[2]) - at_z
            half_x, half_y, half_z = 0.5 * (high[0] - low[0]), 0.5 * (high[1] - low[1]), 0.5 * (high[2] - low[2])
            ahead = axes[0, 0] * mid_x + axes[0, 1] * mid_y + axes[0, 2] * mid_z
            half = abs(axes[0, 0]) * half_x + abs(axes[0, 1]) * half_y + abs(axes[0, 2]) * half_z
            seen = ahead + half > _NEAR_M and ahead - half <= max_range
            for side in range(4):
                inward = sides[side, 0] * mid_x + sides[side, 1] * mid_y + sides[side, 2] * mid_z
                half = abs(sides[side, 0]) * half_x + abs(sides[side, 1]) * half_y + abs(sides[side, 2]) * half_z
                seen = seen and inward + half >= -1e-5
            if not seen:
                node = root + meshes.node_skip[node]
                continue
            first_triangle = base + meshes.node_first[node]
            for triangle in range(first_triangle, first_triangle + meshes.node_count[node]):
                for v in range(3):
                    vertex = meshes.corners[triangle, v]
                    rel_x, rel_y, rel_z = vertex[0] - at_x, vertex[1] - at_y, vertex[2] - at_z
                    for axis in range(3):
                        corner[v, axis] = axes[axis, 0] * rel_x + axes[axis, 1] * rel_y + axes[axis, 2] * rel_z
                # The rectangle of pixels around its part before the camera.
                least_y, most_y, least_z, most_z = np.inf, -np.inf, np.inf, -np.inf
                for v in range(3):
                    a, b = corner[v], corner[(v + 1) % 3]
                    if a[0] > _NEAR_M:
                        slope_y, slope_z = a[1] / a[0], a[2] / a[0]
                        least_y, most_y = min(least_y, slope_y), max(most_y, slope_y)
                        least_z, most_z = min(least_z, slope_z), max(most_z, slope_z)
                    if (a[0] > _NEAR_M) != (b[0] > _NEAR_M):
                        s = (_NEAR_M - a[0]) / (b[0] - a[0])
                        slope_y, slope_z = (a[1] + s * (b[1] - a[1])) / _NEAR_M, (a[2] + s * (b[2] - a[2])) / _NEAR_M
                        least_y, most_y = min(least_y, slope_y), max(most_y, slope_y)
                        least_z, most_z = min(least_z, slope_z), max(most_z, slope_z)
                first_column = math.ceil(max((to_left - most_y) * per_column - 1e-3, 0.0))
                last_column = math.floor(min((to_left - least_y) * per_column + 1e-3, columns - 1.0)) + 1
                first_row = math.ceil(max((up - most_z) * per_row - 1e-3, 0.0))
                last_row = math.floor(min((up - least_z) * per_row + 1e-3, rows - 1.0)) + 1
                if first_column >= last_column or first_row >= last_row:
                    continue
                depth = _edges(corner, edge, passing, normal)
                if depth < 0.0:  # seen from behind
                    depth = -depth
                    for axis in range(3):
                        normal[axis] = -normal[axis]
                        for v in range(3):
                            passing[v, axis] = -passing[v, axis]
                p0, p1, p2 = passing[0], passing[1], passing[2]
                slack_0, slack_1, slack_2 = _slack(p0), _slack(p1), _slack(p2)
                p0y, p1y, p2y, ny = np.float32(p0[1]), np.float32(p1[1]), np.float32(p2[1]), np.float32(normal[1])
                depth_32, which = np.float32(depth), np.int32(number + triangle - base)
                for row in range(first_row, last_row):
                    rise = float(row_slope[row])
                    u0 = np.float32(p0[0] + p0[2] * rise) + slack_0
                    v0 = np.float32(p1[0] + p1[2] * rise) + slack_1
                    w0 = np.float32(p2[0] + p2[2] * rise) + slack_2
                    n0 = np.float32(normal[0] + normal[2] * rise)
                    for c in range(first_column, last_column):
                        slope = column_slope[c]
                        t = depth_32 / (n0 + ny * slope)
                        inside = (u0 + p0y * slope >= 0) & (v0 + p1y * slope >= 0) & (w0 + p2y * slope >= 0)
                        nearer = inside & (t > np.float32(0.0)) & (t < image[row, c])
                        image[row, c] = t if nearer else image[row, c]
                        hits[row, c] = which if nearer else hits[row, c]
            node = root + meshes.node_skip[node] if meshes.node_count[node] > 0 else node + 1
        number += meshes.first_triangle[k + 1] - base


@kernel
def triangle_of_hit(number, places, meshes):
    """Which placed mesh, and which of the set's triangles, is meant by a hit's number less the first one."""
    for m in range(places.shape[0]):
        k = int(places[m, PLACE_NUMBER])
        count = meshes.first_triangle[k + 1] - meshes.first_triangle[k]
        if number < count:
            return m, meshes.first_triangle[k] + number
        number -= count
    return -1, -1
