"""The planar lidar: for each world, the nearest surface along each ray, at the moment at which the ray is measured."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from densecavoid.frames import LidarConfig
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
from densecavoid.sim.people import PARTS
from densecavoid.sim.rays import MISS, disc_interval, prism_distance, rectangle_interval


class LidarOptics(NamedTuple):
    """A `LidarConfig` as the kernels read it."""

    ray_x: np.ndarray  # f32 [rays] unit directions in the robot's frame
    ray_y: np.ndarray  # f32 [rays]
    ray_z: np.ndarray  # f32 [rays]
    start: np.float32  # s, when the first is measured: 0 is when the scan is complete
    interval: np.float32  # s, between two of them
    fov: float
    max_range: np.float32
    height: float
    ahead: float
    cos_pitch: float


def lidar_optics(config: LidarConfig, sweep: bool) -> LidarOptics:
    """The scanner's rays, and where it is; measured one after another in a `sweep`, or all at once."""
    angles = config.angles_rad
    ahead, left = np.cos(angles), np.sin(angles)
    cos, sin = math.cos(config.mount_pitch_rad), math.sin(config.mount_pitch_rad)
    x, y, z = (part.astype(np.float32) for part in (cos * ahead, left, -sin * ahead))
    duration = config.sweep_s if sweep else 0.0
    return LidarOptics(
        x,
        y,
        z,
        np.float32(-duration),
        np.float32(duration / (config.num_rays - 1)),
        float(config.fov_rad),
        np.float32(config.max_range_m),
        float(config.mount_height_m),
        float(config.mount_x_m),
        cos,
    )


@inner
def _scan_angle(bearing, cos_pitch):
    """The angle within the scanner's plane of the ray that is seen from above at `bearing`."""
    turns = math.floor(bearing / (2.0 * math.pi) + 0.5) * 2.0 * math.pi
    within = bearing - turns
    return turns + math.atan2(math.sin(within) * cos_pitch, math.cos(within))


@inner
def _ray_span(bearing, half_width, turn, lidar, num_rays):
    """First and one-past-last ray that can meet something at `bearing` +- `half_width`, seen `turn` turns on."""
    step = lidar.fov / (num_rays - 1)
    low, high = bearing - half_width, bearing + half_width
    if lidar.cos_pitch < 1.0:
        low, high = _scan_angle(low, lidar.cos_pitch), _scan_angle(high, lidar.cos_pitch)
    around = turn * 2.0 * math.pi + 0.5 * lidar.fov
    return max(0, math.ceil((low + around) / step - 1e-3)), min(num_rays, math.floor((high + around) / step + 1e-3) + 1)


@inner
def turn_rays(lidar, angular, ray_x, ray_y):
    """Directions [rays] in the frame of the robot at the end of a sweep during which it turned with `angular` rad/s."""
    for r in range(ray_x.shape[0]):
        turned = angular * (lidar.start + lidar.interval * r)
        cos, sin = math.cos(turned), math.sin(turned)
        ray_x[r] = cos * lidar.ray_x[r] - sin * lidar.ray_y[r]
        ray_y[r] = sin * lidar.ray_x[r] + cos * lidar.ray_y[r]


@inner
def _meet_disc(
    ranges, hits, ray_x, ray_y, ray_z, x, y, drift_x, drift_y, start, interval, radius, z_min, z_max, number
):
    """A cylinder at (x, y) when the scan is complete, moving past the scanner, against the rays that may meet it."""
    for r in range(ranges.shape[0]):
        time = start + interval * np.float32(np.int32(r))
        entry, leave = disc_interval(x + drift_x * time, y + drift_y * time, radius, ray_x[r], ray_y[r])
        t = prism_distance(entry, leave, ray_z[r], z_min, z_max)
        nearer = t < ranges[r]
        hits[r] = number if nearer else hits[r]
        ranges[r] = t if nearer else ranges[r]


@inner
def _meet_rectangle(
    ranges,
    hits,
    ray_x,
    ray_y,
    ray_z,
    x,
    y,
    drift_x,
    drift_y,
    start,
    interval,
    cos,
    sin,
    half_x,
    half_y,
    z_min,
    z_max,
    number,
):
    """The same of a box, in whose frame the scanner is at (x, y); (cos, sin) turn the rays into that frame."""
    for r in range(ranges.shape[0]):
        time = start + interval * np.float32(np.int32(r))
        local_x, local_y = cos * ray_x[r] - sin * ray_y[r], sin * ray_x[r] + cos * ray_y[r]
        entry, leave = rectangle_interval(x + drift_x * time, y + drift_y * time, half_x, half_y, local_x, local_y)
        t = prism_distance(entry, leave, ray_z[r], z_min, z_max)
        nearer = t < ranges[r]
        hits[r] = number if nearer else hits[r]
        ranges[r] = t if nearer else ranges[r]


@inner
def scan(ranges, hits, lidar, ray_x, ray_y, pose, motion, ceiling, boxes, cylinders, velocity, first_box):
    """Casts the rays of one scanner; what they meet is not yet limited to its range.

    Args:
        ranges: [rays] gets the distance along each ray; inf where it meets nothing within the scanner's range.
        hits: i32 [rays] gets what each ray meets: the number of a solid, or `geometry.NOTHING` and so on.
        lidar: the optics.
        ray_x: [rays] directions in the robot's frame, `lidar.ray_x` or what `turn_rays` makes of them; `ray_y` alike.
        pose: (x, y, yaw) of the scanner when the scan is complete.
        motion: (linear, angular) velocity of the robot, whose rays are measured one after another in a sweep.
        ceiling: its height, m.
        boxes: rows; the first has the number `first_box`.
        cylinders: rows; people's parts first.
        velocity: [people, 2] m/s.
    """
    ray_z, start, interval = lidar.ray_z, lidar.start, lidar.interval
    height, max_range, level = lidar.height, lidar.max_range, lidar.cos_pitch >= 1.0
    num_rays = ranges.shape[0]
    for r in range(num_rays):
        down = ray_z[r] < np.float32(0.0)
        flat = np.float32(-height if down else ceiling - height)
        meets = abs(ray_z[r]) > np.float32(1e-9) and flat < MISS
        ranges[r] = flat / ray_z[r] if meets else MISS
        hits[r] = (GROUND if down else CEILING) if meets else NOTHING
    x, y, yaw = pose
    cos, sin = math.cos(yaw), math.sin(yaw)
    # During a sweep things move, and turn, past the scanner: so much further must be looked for them.
    duration = -float(start)
    turned = abs(motion[1]) * duration
    own_x, own_y = np.float32(motion[0]), np.float32(motion[1] * lidar.ahead)
    people_parts = PARTS * velocity.shape[0]
    for i in range(cylinders.shape[0]):
        cylinder = cylinders[i]
        radius = cylinder[CYL_RADIUS]
        z_min, z_max = np.float32(cylinder[CYL_Z_MIN] - height), np.float32(cylinder[CYL_Z_MAX] - height)
        if radius <= 0.0 or (level and (z_min > 0.0 or z_max < 0.0)):
            continue
        rel_x, rel_y = cylinder[CYL_X] - x, cylinder[CYL_Y] - y
        distance = math.sqrt(rel_x * rel_x + rel_y * rel_y)
        if distance - radius > max_range:
            continue
        centre_x = np.float32(cos * rel_x + sin * rel_y)
        centre_y = np.float32(cos * rel_y - sin * rel_x)
        drift_x, drift_y = -own_x, -own_y
        if i < people_parts:
            vel_x, vel_y = velocity[i // PARTS, 0], velocity[i // PARTS, 1]
            drift_x += np.float32(cos * vel_x + sin * vel_y)
            drift_y += np.float32(cos * vel_y - sin * vel_x)
        reach = radius + duration * (abs(drift_x) + abs(drift_y))
        half_width = math.asin(reach / distance) + turned if distance > reach else math.pi
        bearing = math.atan2(centre_y, centre_x)
        for turn in range(-1, 2):
            first, last = _ray_span(bearing, half_width, turn, lidar, num_rays)
            if first < last:
                _meet_disc(
                    ranges[first:last],
                    hits[first:last],
                    ray_x[first:last],
                    ray_y[first:last],
                    ray_z[first:last],
                    centre_x,
                    centre_y,
                    drift_x,
                    drift_y,
                    start + interval * np.float32(first),
                    interval,
                    radius,
                    z_min,
                    z_max,
                    np.int32(i),
                )
    for i in range(boxes.shape[0]):
        box = boxes[i]
        z_min, z_max = np.float32(box[BOX_Z_MIN] - height), np.float32(box[BOX_Z_MAX] - height)
        if level and (z_min > 0.0 or z_max < 0.0):
            continue
        rel_x, rel_y = box[BOX_X] - x, box[BOX_Y] - y
        distance = math.sqrt(rel_x * rel_x + rel_y * rel_y)
        half_x, half_y = box[BOX_HALF_LENGTH], box[BOX_HALF_WIDTH]
        radius = math.sqrt(half_x * half_x + half_y * half_y)
        if distance - radius > max_range:
            continue
        reach = radius + duration * (abs(own_x) + abs(own_y))
        half_width = math.asin(reach / distance) + turned if distance > reach else math.pi
        bearing = math.atan2(cos * rel_y - sin * rel_x, cos * rel_x + sin * rel_y)
        box_cos, box_sin = box[BOX_COS], box[BOX_SIN]
        local_x = np.float32(-(box_cos * rel_x + box_sin * rel_y))
        local_y = np.float32(-(box_cos * rel_y - box_sin * rel_x))
        # From the robot's frame to the box's: a turn by (yaw - box yaw).
        turn_cos = np.float32(box_cos * cos + box_sin * sin)
        turn_sin = np.float32(box_cos * sin - box_sin * cos)
        drift_x, drift_y = turn_cos * own_x - turn_sin * own_y, turn_sin * own_x + turn_cos * own_y
        for turn in range(-1, 2):
            first, last = _ray_span(bearing, half_width, turn, lidar, num_rays)
            if first < last:
                _meet_rectangle(
                    ranges[first:last],
                    hits[first:last],
                    ray_x[first:last],
                    ray_y[first:last],
                    ray_z[first:last],
                    local_x,
                    local_y,
                    drift_x,
                    drift_y,
                    start + interval * np.float32(first),
                    interval,
                    turn_cos,
                    turn_sin,
                    half_x,
                    half_y,
                    z_min,
                    z_max,
                    np.int32(first_box + i),
                )
