"""Which rays of real sensors come back: dark, distant and grazing surfaces return too little light, glass now and then.

A surface of infrared reflectance rho, met at distance r with its normal theta away from the ray, returns light in
proportion to rho cos(theta) / r^2 (a matt surface larger than the beam). What is below the least that the sensor can
measure is lost. Glass lets rays pass, so that they measure what is behind; close to its normal it mirrors enough of the
light back to be measured itself.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from densecavoid.frames import LidarConfig
from densecavoid.sim._jit import inner, kernel
from densecavoid.sim.geometry import (
    BOX_COS,
    BOX_HALF_LENGTH,
    BOX_HALF_WIDTH,
    BOX_SIN,
    BOX_X,
    BOX_Y,
    BOX_Z_MAX,
    BOX_Z_MIN,
    NOTHING,
)
from densecavoid.sim.materials import material_infrared, material_number
from densecavoid.sim.noise import SensorNoiseConfig, hash_of, sensor_key, share_of
from densecavoid.sim.people import PARTS
from densecavoid.sim.rays import prism_distance, rectangle_interval
from densecavoid.sim.surfaces import CLOTHES, SKIN, box_normal, material_at, normal_at, solids_of

_GROUND, _CEILING = material_number("concrete"), material_number("plaster")
_SKIN_INFRARED = 0.5
_CLOTHES_INFRARED = (0.15, 0.65)
"""Of the darkest and the lightest clothes, assumed; black cloth often is bright in the infrared, leather is not."""
_SOFT = 0.2  # the least light varies by this share, so that a surface fades out instead of ending on a line
_WEAK_SCAN, _WEAK_IMAGE, _GLASS_SCAN, _GLASS_IMAGE = 4, 5, 6, 7  # streams of random numbers (noise.py has 1 to 3)


class Returns(NamedTuple):
    """What decides about returns, as the kernels read it."""

    infrared: np.ndarray  # f32 [materials]
    lidar_reach: float  # m, to a surface of reflectance 1 seen straight on
    camera_reach: float
    lidar_glass: float  # chance of a return from glass at its normal
    camera_glass: float
    glass_angle: float  # rad from the normal at which the chance has fallen to 1/e


def returns(config: SensorNoiseConfig, lidar: LidarConfig) -> Returns:
    """The figures for one scanner and camera."""
    return Returns(
        material_infrared(),
        float(config.lidar_reach * lidar.max_range_m) if config.lidar_reach > 0 else math.inf,
        float(config.camera_reach_m) if config.camera_reach_m > 0 else math.inf,
        float(config.lidar_glass),
        float(config.camera_glass),
        max(float(config.glass_angle_rad), 1e-6),
    )


@inner
def _light(solids, hit, origin, ray, distance, optics):
    """Light that comes back from `distance` along a unit `ray`; 1 is what comes from reflectance 1 at 1 m."""
    material = material_at(solids, hit, _GROUND, _CEILING)
    if material == CLOTHES:
        tone = share_of(hash_of(np.uint64(solids.person_id[hit // PARTS]), 17))
        reflectance = _CLOTHES_INFRARED[0] + (_CLOTHES_INFRARED[1] - _CLOTHES_INFRARED[0]) * tone
    elif material == SKIN:
        reflectance = _SKIN_INFRARED
    else:
        reflectance = float(optics.infrared[material])
    x, y, z = origin[0] + distance * ray[0], origin[1] + distance * ray[1], origin[2] + distance * ray[2]
    n_x, n_y, n_z = normal_at(solids, hit, x, y, z)
    return reflectance * abs(n_x * ray[0] + n_y * ray[1] + n_z * ray[2]) / max(distance * distance, 1e-6)


@inner
def _too_weak(light, reach, bits):
    return light * reach * reach < 1.0 + _SOFT * (2.0 * share_of(bits) - 1.0)


@inner
def _glass_returns(peak, angle, cos_incidence, bits):
    away = math.acos(min(abs(cos_incidence), 1.0)) / angle
    return share_of(bits) < peak * math.exp(-away * away)


@inner
def glass_distance(boxes, k, origin, ray):
    """Distance along a ray to box k; inf for a miss."""
    cos, sin = boxes[k, BOX_COS], boxes[k, BOX_SIN]
    rel_x, rel_y = np.float32(origin[0] - boxes[k, BOX_X]), np.float32(origin[1] - boxes[k, BOX_Y])
    local_x, local_y = cos * rel_x + sin * rel_y, cos * rel_y - sin * rel_x
    ray_x, ray_y = np.float32(cos * ray[0] + sin * ray[1]), np.float32(cos * ray[1] - sin * ray[0])
    entry, leave = rectangle_interval(
        local_x, local_y, boxes[k, BOX_HALF_LENGTH], boxes[k, BOX_HALF_WIDTH], ray_x, ray_y
    )
    z_min, z_max = np.float32(boxes[k, BOX_Z_MIN] - origin[2]), np.float32(boxes[k, BOX_Z_MAX] - origin[2])
    return prism_distance(entry, leave, np.float32(ray[2]), z_min, z_max)


@inner
def _what_returns(solids, distance, hit, origin, ray, reach, peak, optics, weak_key, glass_key, index):
    """Distance along a unit `ray` that a real sensor measures, given what it meets first behind all glass; or inf."""
    if hit != NOTHING and _too_weak(
        _light(solids, hit, origin, ray, distance, optics), reach, hash_of(weak_key, index)
    ):
        distance = np.inf
    for k in range(solids.first_glass, solids.num_boxes):
        t = float(glass_distance(solids.boxes, k, origin, ray))
        if 0.0 < t < distance:
            n_x, n_y, n_z = box_normal(
                solids.boxes, k, origin[0] + t * ray[0], origin[1] + t * ray[1], origin[2] + t * ray[2]
            )
            bits = hash_of(hash_of(glass_key, index), k)
            if _glass_returns(peak, optics.glass_angle, n_x * ray[0] + n_y * ray[1] + n_z * ray[2], bits):
                distance = t
    return distance


@kernel
def lose_returns(first, last, state, which, seeds, scans, images, scan_hits, image_hits, lidar, camera, optics):
    """Takes from exact scans and images what does not come back to real sensors, and adds what glass returns."""
    rows, width = images.shape[1], images.shape[2]
    cos_pitch, sin_pitch = math.cos(camera.pitch), math.sin(camera.pitch)
    for b in range(first, last):
        if not which[b]:
            continue
        solids, step = solids_of(state, b), state.step_count[b]
        x, y, yaw = state.robot_pose[b]
        cos, sin = math.cos(yaw), math.sin(yaw)
        weak, glass = sensor_key(seeds[b], step, _WEAK_SCAN), sensor_key(seeds[b], step, _GLASS_SCAN)
        origin = (x + cos * lidar.ahead, y + sin * lidar.ahead, lidar.height)
        for r in range(scans.shape[1]):
            ahead, left = lidar.ray_x[r], lidar.ray_y[r]
            ray = (cos * ahead - sin * left, sin * ahead + cos * left, float(lidar.ray_z[r]))
            hit, distance = scan_hits[b, r], float(scans[b, r])
            scans[b, r] = _what_returns(
                solids, distance, hit, origin, ray, optics.lidar_reach, optics.lidar_glass, optics, weak, glass, r
            )
        weak, glass = sensor_key(seeds[b], step, _WEAK_IMAGE), sensor_key(seeds[b], step, _GLASS_IMAGE)
        origin = (x + cos * camera.ahead, y + sin * camera.ahead, camera.height)
        for v in range(rows):
            up = camera.row_slope[v]
            ahead, rise = cos_pitch + up * sin_pitch, up * cos_pitch - sin_pitch
            for u in range(width):
                left = camera.column_slope[u]
                # Along the ray a depth is longer by the length of the ray of depth 1.
                length = math.sqrt(1.0 + up * up + left * left)
                ray = (
                    (cos * ahead - sin * left) / length,
                    (sin * ahead + cos * left) / length,
                    rise / length,
                )
                hit, distance = image_hits[b, v, u], length * float(images[b, v, u])
                images[b, v, u] = (
                    _what_returns(
                        solids,
                        distance,
                        hit,
                        origin,
                        ray,
                        optics.camera_reach,
                        optics.camera_glass,
                        optics,
                        weak,
                        glass,
                        v * width + u,
                    )
                    / length
                )
