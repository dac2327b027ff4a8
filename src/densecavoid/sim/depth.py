"""The depth camera: for each world, the depth of the nearest surface in each pixel.

In a level camera all pixels of a column share one vertical plane, so footprints are met once a column and heights once
a pixel. A pitched camera takes the general way, each pixel by itself.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from densecavoid.frames import CameraConfig
from densecavoid.sim._jit import inner
from densecavoid.sim.geometry import (
    BOX_COS,
    BOX_HALF_LENGTH,
    BOX_HALF_WIDTH,
    BOX_SIN,
    BOX_X,
    BOX_Y,
    BOX_Z_MAX,
    BOX_Z_MIN,
    CEILING,
    CYL_RADIUS,
    CYL_X,
    CYL_Y,
    CYL_Z_MAX,
    CYL_Z_MIN,
    GROUND,
    NOTHING,
)
from densecavoid.sim.rays import MISS, disc_interval, prism_distance, rectangle_interval


class CameraOptics(NamedTuple):
    """A `CameraConfig` as the kernels read it."""

    column_slope: np.ndarray  # f32 [width]
    row_slope: np.ndarray  # f32 [height]
    min_range: np.float32
    max_range: np.float32
    height: float
    ahead: float
    pitch: float


def camera_optics(config: CameraConfig) -> CameraOptics:
    """The camera's rays in its own frame, and where it is."""
    return CameraOptics(
        config.column_slopes.astype(np.float32),
        config.row_slopes.astype(np.float32),
        np.float32(config.min_range_m),
        np.float32(config.max_range_m),
        float(config.mount_height_m),
        float(config.mount_x_m),
        float(config.mount_pitch_rad),
    )


@inner
def _column_span(bearing, half_width, half_fov, focal, width):
    """First and one-past-last column, from the left, that can show something at `bearing` +- `half_width`."""
    left, right = min(bearing + half_width, half_fov), max(bearing - half_width, -half_fov)
    if left < right:
        return 0, 0
    first = math.ceil(0.5 * width - 0.5 - math.tan(left) * focal - 1e-3)
    last = math.floor(0.5 * width - 0.5 - math.tan(right) * focal + 1e-3) + 1
    return max(0, first), min(width, last)


@inner
def _fill_column(column, row_slope, entry, leave, z_min, z_max):
    """A prism whose footprint the column's rays cross in [entry, leave] > 0, against the rows that may show it."""
    rows = column.shape[0]
    near = max(entry, np.float32(1e-3))
    top = z_max / (near if z_max > np.float32(0.0) else leave)
    bottom = z_min / (near if z_min < np.float32(0.0) else leave)
    per_slope = np.float32(rows - 1) / (row_slope[0] - row_slope[rows - 1])
    first = max(0, math.ceil((row_slope[0] - top) * per_slope - np.float32(1e-2)))
    last = min(rows, math.floor((row_slope[0] - bottom) * per_slope + np.float32(1e-2)) + 1)
    if first < last:
        _meet_rows(column[first:last], row_slope[first:last], entry, leave, z_min, z_max)


@inner
def _meet_rows(column, row_slope, entry, leave, z_min, z_max):
    for r in range(column.shape[0]):
        t = prism_distance(entry, leave, row_slope[r], z_min, z_max)
        column[r] = t if t < column[r] else column[r]


@inner
def render_level_depth(image, columns, camera, x, y, yaw, ceiling, boxes, cylinders, least, most):
    """Casts the rays of a level camera at (x, y) that looks along `yaw`.

    Args:
        image: [height, width] gets the depths from `least` to `most`, NaN elsewhere. What meets nothing within the
            camera's range is at inf.
        columns: [width, height] scratch space: the same image with the rows innermost, where loops vectorise.
    """
    column_slope, row_slope = camera.column_slope, camera.row_slope
    max_range, height = camera.max_range, camera.height
    width, rows = columns.shape
    half_fov = math.atan(column_slope[0]) + 1e-3
    focal = (width - 1) / (column_slope[0] - column_slope[width - 1])
    one = np.float32(1.0)
    for r in range(rows):
        slope = row_slope[r]
        flat = MISS
        if slope < 0.0:
            flat = np.float32(-height / slope)
        elif slope > 0.0:
            flat = np.float32((ceiling - height) / slope)
        columns[0, r] = flat
    for c in range(1, width):
        for r in range(rows):
            columns[c, r] = columns[0, r]
    cos, sin = math.cos(yaw), math.sin(yaw)
    for i in range(cylinders.shape[0]):
        cylinder = cylinders[i]
        radius = cylinder[CYL_RADIUS]
        if radius <= 0.0:
            continue
        rel_x, rel_y = cylinder[CYL_X] - x, cylinder[CYL_Y] - y
        centre_x = np.float32(cos * rel_x + sin * rel_y)
        centre_y = np.float32(cos * rel_y - sin * rel_x)
        if centre_x + radius < 0.0 or centre_x - radius > max_range:
            continue
        distance = math.sqrt(rel_x * rel_x + rel_y * rel_y)
        half_width = math.asin(radius / distance) if distance > radius else math.pi
        first, last = _column_span(math.atan2(centre_y, centre_x), half_width, half_fov, focal, width)
        z_min, z_max = np.float32(cylinder[CYL_Z_MIN] - height), np.float32(cylinder[CYL_Z_MAX] - height)
        for c in range(first, last):
            entry, leave = disc_interval(centre_x, centre_y, radius, one, column_slope[c])
            if entry <= max_range and leave >= 0.0:
                _fill_column(columns[c], row_slope, entry, leave, z_min, z_max)
    for i in range(boxes.shape[0]):
        box = boxes[i]
        rel_x, rel_y = box[BOX_X] - x, box[BOX_Y] - y
        centre_x, centre_y = cos * rel_x + sin * rel_y, cos * rel_y - sin * rel_x
        radius = math.sqrt(box[BOX_HALF_LENGTH] ** 2 + box[BOX_HALF_WIDTH] ** 2)
        if centre_x + radius < 0.0 or centre_x - radius > max_range:
            continue
        distance = math.sqrt(rel_x * rel_x + rel_y * rel_y)
        half_width = math.asin(radius / distance) if distance > radius else math.pi
        first, last = _column_span(math.atan2(centre_y, centre_x), half_width, half_fov, focal, width)
        box_cos, box_sin = box[BOX_COS], box[BOX_SIN]
        local_x = np.float32(-(box_cos * rel_x + box_sin * rel_y))
        local_y = np.float32(-(box_cos * rel_y - box_sin * rel_x))
        turn_cos = np.float32(box_cos * cos + box_sin * sin)
        turn_sin = np.float32(box_cos * sin - box_sin * cos)
        z_min, z_max = np.float32(box[BOX_Z_MIN] - height), np.float32(box[BOX_Z_MAX] - height)
        for c in range(first, last):
            ray_x = turn_cos - turn_sin * column_slope[c]
            ray_y = turn_sin + turn_cos * column_slope[c]
            entry, leave = rectangle_interval(local_x, local_y, box[BOX_HALF_LENGTH], box[BOX_HALF_WIDTH], ray_x, ray_y)
            if leave >= entry and entry <= max_range and leave >= 0.0:
                _fill_column(columns[c], row_slope, entry, leave, z_min, z_max)
    for r in range(rows):
        for c in range(width):
            t = columns[c, r]
            image[r, c] = t if (t >= least) & (t <= most) else np.float32(np.nan)


@inner
def _row_span(tan_left, tan_right, focal, width):
    """First and one-past-last column of one row that can show what lies between two slopes (left per forward)."""
    first = math.ceil(0.5 * width - 0.5 - tan_left * focal - 1e-3)
    last = math.floor(0.5 * width - 0.5 - tan_right * focal + 1e-3) + 1
    return max(0, first), min(width, last)


@inner
def _slopes_of_disc(forward, left, radius):
    """Slopes (left per forward) between which a disc is seen from the origin; an empty span behind it."""
    distance = math.sqrt(forward * forward + left * left)
    half_width = math.asin(radius / distance) if distance > radius else math.pi
    bearing, limit = math.atan2(left, forward), 0.5 * math.pi - 1e-4
    upper, lower = min(bearing + half_width, limit), max(bearing - half_width, -limit)
    if upper <= lower:
        return -1.0, 1.0
    return math.tan(upper), math.tan(lower)


@inner
def _meet_disc(row, hits, column_slope, forward, rise, x, y, radius, z_min, z_max, number):
    """A cylinder at (x, y) from the camera against the pixels of a row that may show it."""
    for c in range(row.shape[0]):
        entry, leave = disc_interval(x, y, radius, forward, column_slope[c])
        t = prism_distance(entry, leave, rise, z_min, z_max)
        nearer = t < row[c]
        hits[c] = number if nearer else hits[c]
        row[c] = t if nearer else row[c]


@inner
def _meet_rectangle(row, hits, column_slope, forward, rise, x, y, cos, sin, half_x, half_y, z_min, z_max, number):
    """The same of a box, in whose frame the camera is at (x, y); (cos, sin) turn the rays into that frame."""
    for c in range(row.shape[0]):
        local_x, local_y = cos * forward - sin * column_slope[c], sin * forward + cos * column_slope[c]
        entry, leave = rectangle_interval(x, y, half_x, half_y, local_x, local_y)
        t = prism_distance(entry, leave, rise, z_min, z_max)
        nearer = t < row[c]
        hits[c] = number if nearer else hits[c]
        row[c] = t if nearer else row[c]


@inner
def _pitched(slope, cos_pitch, sin_pitch):
    """Forward and upward part of a row's rays of depth 1, in the robot's upright frame."""
    return cos_pitch + slope * sin_pitch, slope * cos_pitch - sin_pitch


@inner
def render_depth(image, hits, camera, x, y, yaw, ceiling, boxes, cylinders, first_box):
    """Casts the rays of a camera of any pitch at (x, y), turned to `yaw`; depths are not yet limited to its range.

    Args:
        image: [height, width] gets the depths; inf where a ray meets nothing within the camera's range.
        hits: i32 [height, width] gets what each ray meets: the number of a solid, or `geometry.NOTHING` and so on.
        first_box: number of the first box.
    """
    column_slope, row_slope = camera.column_slope, camera.row_slope
    height = camera.height
    rows, width = image.shape
    focal = (width - 1) / (column_slope[0] - column_slope[width - 1])
    # A ray of depth 1 in the robot's upright frame: `forward`, the column's slope to the left, and `rise`.
    cos_pitch, sin_pitch = np.float32(math.cos(camera.pitch)), np.float32(math.sin(camera.pitch))
    for r in range(rows):
        _, rise = _pitched(row_slope[r], cos_pitch, sin_pitch)
        down = rise < 0.0
        flat = np.float32(-height if down else ceiling - height)
        meets = abs(rise) > np.float32(1e-9) and flat < MISS
        image[r] = flat / rise if meets else MISS
        hits[r] = (GROUND if down else CEILING) if meets else NOTHING
    reach = camera.max_range * (cos_pitch + abs(sin_pitch) * row_slope[0])
    cos, sin = math.cos(yaw), math.sin(yaw)
    for i in range(cylinders.shape[0]):
        cylinder = cylinders[i]
        radius = cylinder[CYL_RADIUS]
        if radius <= 0.0:
            continue
        rel_x, rel_y = cylinder[CYL_X] - x, cylinder[CYL_Y] - y
        centre_x = np.float32(cos * rel_x + sin * rel_y)
        centre_y = np.float32(cos * rel_y - sin * rel_x)
        if centre_x + radius < 0.0 or centre_x - radius > reach:
            continue
        tan_left, tan_right = _slopes_of_disc(centre_x, centre_y, radius)
        z_min, z_max = np.float32(cylinder[CYL_Z_MIN] - height), np.float32(cylinder[CYL_Z_MAX] - height)
        for r in range(rows):
            forward, rise = _pitched(row_slope[r], cos_pitch, sin_pitch)
            first, last = _row_span(tan_left, tan_right, focal * forward, width)
            if first < last:
                row, met, slopes = image[r, first:last], hits[r, first:last], column_slope[first:last]
                number = np.int32(i)
                _meet_disc(row, met, slopes, forward, rise, centre_x, centre_y, radius, z_min, z_max, number)
    for i in range(boxes.shape[0]):
        box = boxes[i]
        rel_x, rel_y = box[BOX_X] - x, box[BOX_Y] - y
        centre_x, centre_y = cos * rel_x + sin * rel_y, cos * rel_y - sin * rel_x
        half_x, half_y = box[BOX_HALF_LENGTH], box[BOX_HALF_WIDTH]
        radius = math.sqrt(half_x**2 + half_y**2)
        if centre_x + radius < 0.0 or centre_x - radius > reach:
            continue
        tan_left, tan_right = _slopes_of_disc(centre_x, centre_y, radius)
        box_cos, box_sin = box[BOX_COS], box[BOX_SIN]
        local_x = np.float32(-(box_cos * rel_x + box_sin * rel_y))
        local_y = np.float32(-(box_cos * rel_y - box_sin * rel_x))
        turn_cos = np.float32(box_cos * cos + box_sin * sin)
        turn_sin = np.float32(box_cos * sin - box_sin * cos)
        z_min, z_max = np.float32(box[BOX_Z_MIN] - height), np.float32(box[BOX_Z_MAX] - height)
        for r in range(rows):
            forward, rise = _pitched(row_slope[r], cos_pitch, sin_pitch)
            first, last = _row_span(tan_left, tan_right, focal * forward, width)
            if first < last:
                _meet_rectangle(
                    image[r, first:last],
                    hits[r, first:last],
                    column_slope[first:last],
                    forward,
                    rise,
                    local_x,
                    local_y,
                    turn_cos,
                    turn_sin,
                    half_x,
                    half_y,
                    z_min,
                    z_max,
                    np.int32(first_box + i),
                )
