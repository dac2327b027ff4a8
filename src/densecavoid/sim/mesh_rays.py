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
def _minus(a, b):
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@inner
def _cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inner
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inner
def _seen_from(at, axes, vertex):
    """A vertex relative to a place in the mesh's frame, along the axes of a sensor there."""
    offset = (vertex[0] - at[0], vertex[1] - at[1], vertex[2] - at[2])
    return _dot(axes[0], offset), _dot(axes[1], offset), _dot(axes[2], offset)


@inner
def _corners_from(at, axes, corners):
    """The same of a triangle's three."""
    return _seen_from(at, axes, corners[0]), _seen_from(at, axes, corners[1]), _seen_from(at, axes, corners[2])


@inner
def _in_frame(place, x, y, z, yaw):
    """A sensor in the frame of a mesh that stands at `place`: where it is, cosine and sine of its yaw there."""
    rel_x, rel_y = x - place[PLACE_X], y - place[PLACE_Y]
    at_x = place[PLACE_COS] * rel_x + place[PLACE_SIN] * rel_y
    at_y = place[PLACE_COS] * rel_y - place[PLACE_SIN] * rel_x
    cos, sin = math.cos(yaw), math.sin(yaw)
    turn_cos = cos * place[PLACE_COS] + sin * place[PLACE_SIN]
    turn_sin = sin * place[PLACE_COS] - cos * place[PLACE_SIN]
    return (at_x, at_y, z - place[PLACE_Z]), turn_cos, turn_sin


@inner
def _middle_and_half(low, high, at):
    """A bounding box's middle, from a place in the mesh's frame, and half its sizes."""
    middle = (0.5 * (low[0] + high[0]) - at[0], 0.5 * (low[1] + high[1]) - at[1], 0.5 * (low[2] + high[2]) - at[2])
    return middle, (0.5 * (high[0] - low[0]), 0.5 * (high[1] - low[1]), 0.5 * (high[2] - low[2]))


@inner
def _reach(normal, half):
    """How far a box reaches from its middle along a normal."""
    return abs(normal[0]) * half[0] + abs(normal[1]) * half[1] + abs(normal[2]) * half[2]


@inner
def _single(a):
    return np.float32(a[0]), np.float32(a[1]), np.float32(a[2])


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
            `triangle_of_hit`).
        x, y, z, yaw: the scanner in the world.
        dir_x, dir_y, dir_z: f32 [rays] unit directions turned by `yaw`, in order of their bearing, counter-clockwise.
        start_x, start_y: f32 [rays] where each ray starts, from (x, y) and turned by `yaw` too, for a scanner in
            motion; of length 0 if all start there.
        places: f64 [M, 6] (mesh.PLACE_...), meshes: the `MeshSet` they are numbered in.
    """
    num_rays = ranges.shape[0]
    if start_x.shape[0] == 0:
        start_x = start_y = np.zeros(num_rays, np.float32)
    # The plane that the rays lie in (a scanner's do, whatever its pitch), and how far any ray leaves it.
    position = np.empty(num_rays)
    i, j = num_rays // 3, 2 * num_rays // 3
    plane = _cross(
        (float(dir_x[i]), float(dir_y[i]), float(dir_z[i])), (float(dir_x[j]), float(dir_y[j]), float(dir_z[j]))
    )
    length = math.sqrt(_dot(plane, plane))
    scale = 1.0 / length if length > 1e-6 else 0.0  # without a plane nothing is left out for its height
    plane = (plane[0] * scale, plane[1] * scale, plane[2] * scale)
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
    number = first_hit_number
    for m in range(places.shape[0]):
        place = places[m]
        k = int(place[PLACE_NUMBER])
        # A direction of the scanner's is one in the mesh's frame turned by (turn_cos, turn_sin).
        at, turn_cos, turn_sin = _in_frame(place, x, y, z, yaw)
        axes = ((turn_cos, turn_sin, 0.0), (-turn_sin, turn_cos, 0.0), (0.0, 0.0, 1.0))
        plane_there = (
            turn_cos * plane[0] - turn_sin * plane[1], turn_sin * plane[0] + turn_cos * plane[1], plane[2]
        )  # fmt: skip
        root, base = meshes.first_node[k], meshes.first_triangle[k]
        node, end = root, meshes.first_node[k + 1]
        while node < end:
            middle_of_box, half = _middle_and_half(meshes.node_low[node], meshes.node_high[node], at)
            off_x, off_y = max(abs(middle_of_box[0]) - half[0], 0.0), max(abs(middle_of_box[1]) - half[1], 0.0)
            off_plane, half_plane = abs(_dot(plane_there, middle_of_box)), _reach(plane_there, half)
            reach = max_range + shift
            if off_x * off_x + off_y * off_y > reach * reach or off_plane > half_plane + leaves:
                node = root + meshes.node_skip[node]
                continue
            margin = 1e-6 + (1.6 * shift + 1e-6) / max(math.sqrt(off_x * off_x + off_y * off_y), 1e-9)
            first_triangle = base + meshes.node_first[node]
            for triangle in range(first_triangle, first_triangle + meshes.node_count[node]):
                a, b, c = _corners_from(at, axes, meshes.corners[triangle])
                a_off, b_off, c_off = _dot(plane, a), _dot(plane, b), _dot(plane, c)
                if min(a_off, b_off, c_off) > leaves or max(a_off, b_off, c_off) < -leaves:
                    continue
                # The triangle's part of the circle; all of it around or right beside the scanner.
                start = _circle_position(a[0], a[1])
                to_b = _apart(start, _circle_position(b[0], b[1]))
                to_c = _apart(start, _circle_position(c[0], c[1]))
                right, left = min(0.0, to_b, to_c), max(0.0, to_b, to_c)
                if left - right + 2.0 * margin >= 2.0 - 1e-6:
                    right, left = position[0], position[-1] + 1e-6
                else:
                    right, left = start + right - margin, start + left + margin
                while right > position[0]:
                    right, left = right - 4.0, left - 4.0
                edge_0, edge_1, edge_2 = _minus(b, a), _minus(c, b), _minus(a, c)
                passing_0, passing_1, passing_2 = _cross(a, edge_0), _cross(b, edge_1), _cross(c, edge_2)
                normal = _cross(edge_0, edge_1)
                depth = np.float32(_dot(normal, a))
                slack_0, slack_1, slack_2 = _slack(passing_0), _slack(passing_1), _slack(passing_2)
                p0, p1, p2 = _single(passing_0), _single(passing_1), _single(passing_2)
                e0, e1, e2, n = _single(edge_0), _single(edge_1), _single(edge_2), _single(normal)
                which = np.int32(number + triangle - base)
                while right <= position[-1]:
                    first, last = _first_from(position, right), _first_from(position, left)
                    right, left = right + 4.0, left + 4.0
                    for r in range(first, last):
                        ray, sx, sy = (dir_x[r], dir_y[r], dir_z[r]), start_x[r], start_y[r]
                        # The ray's moment, start x direction, is what its start changes.
                        moment = (sy * ray[2], -sx * ray[2], sx * ray[1] - sy * ray[0])
                        u = _dot(p0, ray) + _dot(e0, moment)
                        v = _dot(p1, ray) + _dot(e1, moment)
                        w = _dot(p2, ray) + _dot(e2, moment)
                        t = (depth - n[0] * sx - n[1] * sy) / _dot(n, ray)
                        inside = (u >= -slack_0) & (v >= -slack_1) & (w >= -slack_2)
                        inside |= (u <= slack_0) & (v <= slack_1) & (w <= slack_2)
                        nearer = inside & (t > np.float32(0.0)) & (t < ranges[r])
                        ranges[r] = t if nearer else ranges[r]
                        hits[r] = which if nearer else hits[r]
            node = root + meshes.node_skip[node] if meshes.node_count[node] > 0 else node + 1
        number += meshes.first_triangle[k + 1] - base


@inner
def _side(forward, sideways, slope):
    """Normal of the plane through a camera at one side of its view."""
    return sideways[0] - slope * forward[0], sideways[1] - slope * forward[1], sideways[2] - slope * forward[2]


@inner
def _with_edge(around, a, b):
    """A rectangle of slopes grown by an edge's first corner, and by where the edge comes out of the camera's plane."""
    least_y, most_y, least_z, most_z = around
    if a[0] > _NEAR_M:
        slope_y, slope_z = a[1] / a[0], a[2] / a[0]
        least_y, most_y, least_z, most_z = (
            min(least_y, slope_y), max(most_y, slope_y), min(least_z, slope_z), max(most_z, slope_z)
        )  # fmt: skip
    if (a[0] > _NEAR_M) != (b[0] > _NEAR_M):
        s = (_NEAR_M - a[0]) / (b[0] - a[0])
        slope_y, slope_z = (a[1] + s * (b[1] - a[1])) / _NEAR_M, (a[2] + s * (b[2] - a[2])) / _NEAR_M
        least_y, most_y, least_z, most_z = (
            min(least_y, slope_y), max(most_y, slope_y), min(least_z, slope_z), max(most_z, slope_z)
        )  # fmt: skip
    return least_y, most_y, least_z, most_z


@kernel
def mesh_depth(image, hits, first_hit_number, x, y, z, yaw, column_slope, row_slope, pitch, max_range, places, meshes):
    """Lessens the depths of `image` [height, width] where a mesh is nearer.

    Args:
        image: raw depths along the optical axis so far; inf where nothing is met.
        hits: i32 [height, width] as in `mesh_scan`.
        x, y, z, yaw, pitch: the camera in the world (pitch down).
        column_slope, row_slope: f32, evenly spaced, of each column to the left and of each row upwards.
        places: f64 [M, 6] (mesh.PLACE_...), meshes: the `MeshSet` they are numbered in.
    """
    rows, columns = image.shape
    to_left, to_right, up, down = column_slope[0], column_slope[-1], row_slope[0], row_slope[-1]
    per_column, per_row = (columns - 1) / (to_left - to_right), (rows - 1) / (up - down)
    cos_pitch, sin_pitch = math.cos(pitch), math.sin(pitch)
    number = first_hit_number
    for m in range(places.shape[0]):
        place = places[m]
        k = int(place[PLACE_NUMBER])
        at, cos, sin = _in_frame(place, x, y, z, yaw)
        # In the mesh's frame: the camera's axes, and normals (to the left, and up) of the four sides of its view.
        forward, leftward = (cos * cos_pitch, sin * cos_pitch, -sin_pitch), (-sin, cos, 0.0)
        upward = (cos * sin_pitch, sin * sin_pitch, cos_pitch)
        axes = (forward, leftward, upward)
        side_0, side_1 = _side(forward, leftward, to_left), _side(forward, leftward, to_right)
        side_2, side_3 = _side(forward, upward, up), _side(forward, upward, down)
        root, base = meshes.first_node[k], meshes.first_triangle[k]
        node, end = root, meshes.first_node[k + 1]
        while node < end:
            middle, half = _middle_and_half(meshes.node_low[node], meshes.node_high[node], at)
            ahead, deep = _dot(forward, middle), _reach(forward, half)
            seen = (ahead + deep > _NEAR_M) & (ahead - deep <= max_range)
            seen &= (_dot(side_0, middle) <= _reach(side_0, half)) & (_dot(side_1, middle) >= -_reach(side_1, half))
            seen &= (_dot(side_2, middle) <= _reach(side_2, half)) & (_dot(side_3, middle) >= -_reach(side_3, half))
            if not seen:
                node = root + meshes.node_skip[node]
                continue
            first_triangle = base + meshes.node_first[node]
            for triangle in range(first_triangle, first_triangle + meshes.node_count[node]):
                a, b, c = _corners_from(at, axes, meshes.corners[triangle])
                # The rectangle of pixels around its part before the camera.
                around = _with_edge(_with_edge(_with_edge((np.inf, -np.inf, np.inf, -np.inf), a, b), b, c), c, a)
                least_y, most_y, least_z, most_z = around
                first_column = math.ceil(max((to_left - most_y) * per_column - 1e-3, 0.0))
                last_column = math.floor(min((to_left - least_y) * per_column + 1e-3, columns - 1.0)) + 1
                first_row = math.ceil(max((up - most_z) * per_row - 1e-3, 0.0))
                last_row = math.floor(min((up - least_z) * per_row + 1e-3, rows - 1.0)) + 1
                if first_column >= last_column or first_row >= last_row:
                    continue
                edge_0, edge_1, edge_2 = _minus(b, a), _minus(c, b), _minus(a, c)
                p0, p1, p2 = _cross(a, edge_0), _cross(b, edge_1), _cross(c, edge_2)
                slack_0, slack_1, slack_2 = _slack(p0), _slack(p1), _slack(p2)
                n = _cross(edge_0, edge_1)
                turned = 1.0 if _dot(n, a) > 0.0 else -1.0  # seen from behind
                depth, which = np.float32(abs(_dot(n, a))), np.int32(number + triangle - base)
                u1, v1, w1 = np.float32(turned * p0[1]), np.float32(turned * p1[1]), np.float32(turned * p2[1])
                n1 = np.float32(turned * n[1])
                for row in range(first_row, last_row):
                    rise = float(row_slope[row])
                    u0 = np.float32(turned * (p0[0] + p0[2] * rise)) + slack_0
                    v0 = np.float32(turned * (p1[0] + p1[2] * rise)) + slack_1
                    w0 = np.float32(turned * (p2[0] + p2[2] * rise)) + slack_2
                    n0 = np.float32(turned * (n[0] + n[2] * rise))
                    for column in range(first_column, last_column):
                        slope = column_slope[column]
                        t = depth / (n0 + n1 * slope)
                        inside = (u0 + u1 * slope >= 0) & (v0 + v1 * slope >= 0) & (w0 + w1 * slope >= 0)
                        nearer = inside & (t > np.float32(0.0)) & (t < image[row, column])
                        image[row, column] = t if nearer else image[row, column]
                        hits[row, column] = which if nearer else hits[row, column]
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
