"""The planar lidar: for each world, the nearest surface along each ray at the scanner's height."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from densecavoid.frames import LidarConfig
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
from densecavoid.sim.rays import MISS, disc_interval, rectangle_interval


class LidarOptics(NamedTuple):
    """A `LidarConfig` as the kernel reads it."""

    ray_x: np.ndarray  # f32 [rays]
    ray_y: np.ndarray  # f32 [rays]
    fov: float
    max_range: np.float32
    height: float
    ahead: float


def lidar_optics(config: LidarConfig) -> LidarOptics:
    """The scanner's rays in its own frame, and where it is."""
    angles = config.angles_rad
    return LidarOptics(
        np.cos(angles).astype(np.float32),
        np.sin(angles).astype(np.float32),
        float(config.fov_rad),
        np.float32(config.max_range_m),
        float(config.mount_height_m),
        float(config.mount_x_m),
    )


@kernel
def _ray_span(bearing, half_width, turn, fov, num_rays):
    """First and one-past-last ray that can meet something at `bearing` +- `half_width`, seen `turn` turns on."""
    step = fov / (num_rays - 1)
    low = (bearing - half_width + turn * 2.0 * math.pi + 0.5 * fov) / step
    high = (bearing + half_width + turn * 2.0 * math.pi + 0.5 * fov) / step
    return max(0, math.ceil(low - 1e-3)), min(num_rays, math.floor(high + 1e-3) + 1)


@kernel
def scan(ranges, lidar, x, y, yaw, boxes, cylinders):
    """Fills `ranges` [rays] for a scanner at (x, y) with heading `yaw`; inf where nothing is in range."""
    dir_x, dir_y, fov = lidar.ray_x, lidar.ray_y, lidar.fov
    max_range, height = lidar.max_range, lidar.height
    ranges[:] = MISS
    num_rays = ranges.shape[0]
    cos, sin = math.cos(yaw), math.sin(yaw)
    for i in range(cylinders.shape[0]):
        cylinder = cylinders[i]
        radius = cylinder[CYL_RADIUS]
        if radius <= 0.0 or cylinder[CYL_Z_MIN] > height or cylinder[CYL_Z_MAX] < height:
            continue
        rel_x, rel_y = cylinder[CYL_X] - x, cylinder[CYL_Y] - y
        distance = math.sqrt(rel_x * rel_x + rel_y * rel_y)
        if distance - radius > max_range:
            continue
        centre_x = np.float32(cos * rel_x + sin * rel_y)
        centre_y = np.float32(cos * rel_y - sin * rel_x)
        half_width = math.asin(radius / distance) if distance > radius else math.pi
        bearing = math.atan2(centre_y, centre_x)
        for turn in range(-1, 2):
            first, last = _ray_span(bearing, half_width, turn, fov, num_rays)
            for r in range(first, last):
                entry, leave = disc_interval(centre_x, centre_y, radius, dir_x[r], dir_y[r])
                entry = entry if entry > np.float32(0.0) else np.float32(0.0)
                entry = entry if leave >= entry else MISS
                ranges[r] = entry if entry < ranges[r] else ranges[r]
    for i in range(boxes.shape[0]):
        box = boxes[i]
        if box[BOX_Z_MIN] > height or box[BOX_Z_MAX] < height:
            continue
        rel_x, rel_y = box[BOX_X] - x, box[BOX_Y] - y
        distance = math.sqrt(rel_x * rel_x + rel_y * rel_y)
        radius = math.sqrt(box[BOX_HALF_LENGTH] ** 2 + box[BOX_HALF_WIDTH] ** 2)
        if distance - radius > max_range:
            continue
        half_width = math.asin(radius / distance) if distance > radius else math.pi
        bearing = math.atan2(cos * rel_y - sin * rel_x, cos * rel_x + sin * rel_y)
        box_cos, box_sin = box[BOX_COS], box[BOX_SIN]
        local_x = np.float32(-(box_cos * rel_x + box_sin * rel_y))
        local_y = np.float32(-(box_cos * rel_y - box_sin * rel_x))
        # From the sensor's frame to the box's: a turn by (yaw - box yaw).
        turn_cos = np.float32(box_cos * cos + box_sin * sin)
        turn_sin = np.float32(box_cos * sin - box_sin * cos)
        half_x, half_y = box[BOX_HALF_LENGTH], box[BOX_HALF_WIDTH]
        for turn in range(-1, 2):
            first, last = _ray_span(bearing, half_width, turn, fov, num_rays)
            for r in range(first, last):
                ray_x = turn_cos * dir_x[r] - turn_sin * dir_y[r]
                ray_y = turn_sin * dir_x[r] + turn_cos * dir_y[r]
                entry, leave = rectangle_interval(local_x, local_y, half_x, half_y, ray_x, ray_y)
                entry = entry if entry > np.float32(0.0) else np.float32(0.0)
                entry = entry if leave >= entry else MISS
                ranges[r] = entry if entry < ranges[r] else ranges[r]
    for r in range(num_rays):
        if ranges[r] > max_range:
            ranges[r] = MISS
