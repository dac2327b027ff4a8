"""The level depth camera: for each world, the depth of the nearest surface in each pixel.

All pixels of a column share one vertical plane, so footprints are met once a column and heights once a pixel.
"""

from __future__ import annotations

import math

import numpy as np

from densecavoid.sim._jit import kernel
from densecavoid.sim.geometry import (
    BOX_COS,
    BOX_HALF_LENGTH,
    BOX_HALF_WIDTH,
    BOX_SIN,
    BOX_X,
    BOX_Y,
    BOX_Z_MAX,
    BOX_Z_MIN,
    CYL_RADIUS,
    CYL_X,
    CYL_Y,
    CYL_Z_MAX,
    CYL_Z_MIN,
)
from densecavoid.sim.rays import MISS, disc_interval, prism_distance, rectangle_interval


@kernel
def _column_span(bearing, half_width, half_fov, focal, width):
    """First and one-past-last column, from the left, that can show something at `bearing` +- `half_width`."""
    left, right = min(bearing + half_width, half_fov), max(bearing - half_width, -half_fov)
    if left < right:
        return 0, 0
    first = math.ceil(0.5 * width - 0.5 - math.tan(left) * focal - 1e-3)
    last = math.floor(0.5 * width - 0.5 - math.tan(right) * focal + 1e-3) + 1
    return max(0, first), min(width, last)


@kernel
def _fill_column(column, row_slope, entry, leave, z_min, z_max):
    for r in range(column.shape[0]):
        t = prism_distance(entry, leave, row_slope[r], z_min, z_max)
        column[r] = t if t < column[r] else column[r]


@kernel
def render_depth(
    image, columns, column_slope, row_slope, min_range, max_range, height, ceiling, x, y, yaw, boxes, cylinders
):
    """Fills `image` [height, width] with depths for a camera at (x, y, height) looking along `yaw`; NaN for none.

    `columns` [width, height] is scratch space: the same image with the rows innermost, where loops vectorise.
    """
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
        for c in range(width):
            columns[c, r] = flat
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
    for c in range(width):
        for r in range(rows):
            t = columns[c, r]
            image[r, c] = t if (t >= min_range) & (t <= max_range) else np.float32(np.nan)
