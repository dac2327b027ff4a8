"""Ought a sensor to see a person who stands there? What a miss is worth hangs on it: the hidden are missed by nobody's
fault.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from densecavoid.frames import CameraConfig, LidarConfig
from densecavoid.perception.projection import (
    CameraView,
    ahead_per_depth,
    body_sides,
    camera_view,
    from_camera,
    image_height,
)
from densecavoid.sim._jit import kernel

_HIDES_M = 0.15  # what is nearer than a body's near side by more than this hides it
_TRUNK = (0.4, 0.6, 0.75)  # of body height: where the camera looks for what hides
_COLUMNS = 5
_LEGS_HALF_WIDTH_M = 0.12
_LEGS_DEPTH_M = 0.35  # legs return between this much before and behind a person's axis


class DepthView(NamedTuple):
    """Depth images and how they were taken."""

    depth: np.ndarray  # f32 [B, height, width], NaN where there is none
    camera: CameraView
    min_range: float
    max_range: float


class LidarView(NamedTuple):
    """Scans and how they were taken."""

    scan: np.ndarray  # f32 [B, rays], inf where nothing is in range
    mount_x: float
    angle_min: float
    increment: float
    max_range: float


def depth_view(depth_m: np.ndarray, config: CameraConfig) -> DepthView:
    """Depth images [B, height, width] of that camera."""
    return DepthView(depth_m, camera_view(config), float(config.min_range_m), float(config.max_range_m))


def lidar_view(scan_m: np.ndarray, config: LidarConfig) -> LidarView:
    """Scans [B, rays] of that lidar."""
    increment = config.fov_rad / (config.num_rays - 1)
    return LidarView(scan_m, float(config.mount_x_m), -config.fov_rad / 2, float(increment), float(config.max_range_m))


@kernel
def seen_by_camera(view, b, pose, x, y, radius, height):
    """Share of a trunk that stands at x, y (same frame as `pose`: x, y, yaw) that nothing nearer hides from the camera
    of world b, what lies outside the image or its ranges included.

    Where there is no depth, half counts as hidden: nothing is known of what is there.
    """
    camera = view.camera
    forward, left = from_camera(camera, pose, x, y)
    if not view.min_range <= forward - radius or forward > view.max_range:
        return 0.0
    right_side, left_side = body_sides(forward, left, radius)
    seen = 0.0
    for level in _TRUNK:
        v = image_height(camera, (level * height - camera.height_m) / forward)
        row = math.floor(v)
        if not 0 <= row < camera.rows:
            continue
        per_depth = ahead_per_depth(camera, v)
        nearest = (forward - radius - _HIDES_M) / per_depth
        for part in range(_COLUMNS):
            slope = left_side + (right_side - left_side) * (part + 0.5) / _COLUMNS
            column = math.floor(0.5 * camera.width - camera.focal_x * per_depth * slope)
            if 0 <= column < camera.width:
                depth = view.depth[b, row, column]
                if depth > nearest:
                    seen += 1.0
                elif not depth <= nearest:  # NaN
                    seen += 0.5
    return seen / (_COLUMNS * len(_TRUNK))


@kernel
def legs_seen_by_lidar(view, b, pose, x, y):
    """How surely the lidar of world b ought to see the legs of a person at x, y: the share of the rays towards them
    that are not stopped before; and the share that passes beyond, where legs would stop them.

    Returns:
        (share not stopped before, share that passes through), both 0 outside the field of view or the range.
    """
    num_rays = view.scan.shape[1]
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    off_x, off_y = x - pose[0], y - pose[1]
    forward, left = cos * off_x + sin * off_y - view.mount_x, cos * off_y - sin * off_x
    distance = math.sqrt(forward * forward + left * left)
    if not 0.2 < distance <= view.max_range - _LEGS_DEPTH_M:
        return 0.0, 0.0
    half = math.asin(min(_LEGS_HALF_WIDTH_M / distance, 1.0))
    bearing = (math.atan2(left, forward) - view.angle_min) / view.increment
    first, last = math.ceil(bearing - half / view.increment), math.floor(bearing + half / view.increment)
    if first < 0 or last >= num_rays or last < first:
        return 0.0, 0.0
    reached, through = 0, 0
    for ray in range(int(first), int(last) + 1):
        reached += view.scan[b, ray] > distance - _LEGS_DEPTH_M
        through += view.scan[b, ray] > distance + _LEGS_DEPTH_M
    count = last - first + 1
    return reached / count, through / count
