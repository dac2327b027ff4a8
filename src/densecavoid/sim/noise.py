"""What real sensors add to exact ones: noise, steps, lost and mixed values, drifting odometry. Not the geometry.

All randomness is a hash of (the world's seed, the control step, the sensor, the pixel): a world's noise depends neither
on the batch nor on the threads, and looking twice in one step gives the same values.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from densecavoid.frames import CameraConfig, LidarConfig, require
from densecavoid.sim._jit import inner, kernel


@dataclass(frozen=True)
class SensorNoiseConfig:
    """Magnitudes of the errors of `real` sensors; standard deviations unless said otherwise. 0 switches one off."""

    lidar_range_share: float = 0.005
    """Of the range, and of 1 m below that: the URG-04LX datasheet's accuracy of 10 mm to 1 m and 1 % beyond, as two
    standard deviations."""
    lidar_step_m: float = 0.001
    """Ranges come in whole millimetres (URG-04LX datasheet, SCIP 2.0)."""
    lidar_beam_rad: float = 0.01
    """Full width of the beam: a spot of 40 mm at 4 m (URG-04LX-UG01 datasheet). A beam on an edge gives a range between
    the two surfaces (mixed pixel: Okubo, Ye, Borenstein, Proc. SPIE 7332, 2009)."""
    lidar_dropout: float = 0.005
    """Share of rays without a return. An assumed mean; what
    dark and grazing surfaces lose comes on top (returns.py)."""
    camera_floor_m: float = 0.0012
    camera_per_m2: float = 0.0019
    """Depth noise floor + per_m2 (z - .4 m)^2 of structured light (Nguyen, Izadi, Lovell, 3DIMPVT 2012, frontal)."""
    camera_disparity_step: float = 0.00285
    """Step of the inverse depth, 1/m: 2.85 mm at 1 m, 7 cm at 5 m (Khoshelham, Elberink, Sensors 12, 2012)."""
    camera_baseline_m: float = 0.075
    """Between projector and camera (Astra's and Kinect's): what the projector does not light, beside near things on
    their left in the image, has no depth."""
    camera_edge_px: float = 0.85
    """Sideways jitter of depth edges, in pixels of a 640 px wide image (Nguyen et al.: .8 to .9 px)."""
    camera_dropout: float = 0.01
    """Share of pixels without depth; assumed, as with the lidar."""
    lidar_reach: float = 1.6
    """Distance at which a surface of reflectance 1 seen straight on is just measured, as a multiple of the range for
    which the scanner is sold; 0: nothing is ever too dark. Assumed: four metres are promised on white paper, and black
    things vanish beyond 1 to 1.5 m (Kneip et al., ICRA 2009)."""
    camera_reach_m: float = 12.0
    """The same of the depth camera, in metres. Assumed."""
    lidar_glass: float = 0.95
    """Chance that a beam along a pane's normal returns from the pane. Assumed: panes are seen within some degrees of
    the normal and hardly elsewhere (Foster, Sun, Park, Kuipers, ICRA 2013)."""
    camera_glass: float = 0.3
    """The same of the depth camera's light. Assumed."""
    glass_angle_rad: float = 0.14
    """Angle from the normal at which these chances are down to 1/e, as exp(-(angle / this)^2): 8 degrees, assumed."""
    odometry_scale: float = 0.01
    """Share by which an episode's distances are wrong. UMBmark squares of 16 m end .3 m off before calibration and
    .03 m after (Borenstein, Feng, IEEE Trans. Robotics and Automation 12, 1996); between the two."""
    odometry_turn_scale: float = 0.01
    """Share by which an episode's turns are wrong: a gyroscope's scale error (1 % is common for such parts)."""
    odometry_walk: float = 0.005
    """Random walk of the heading, rad per square root of a metre driven; assumed: 1 degree after 12 m."""

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            value = getattr(self, name)
            require(value >= 0 and math.isfinite(value), f"SensorNoiseConfig.{name}", value, "0 or more, and finite")
        for name in ("lidar_dropout", "camera_dropout", "lidar_glass", "camera_glass"):
            require(getattr(self, name) <= 1, f"SensorNoiseConfig.{name}", getattr(self, name), "at most 1")


class ScanNoise(NamedTuple):
    """Errors of a scan as the kernel reads them."""

    range_share: float
    step: float
    mixed: float  # probability that a ray beside an edge is cut by it
    dropout: float
    min_range: float
    max_range: float


class DepthNoise(NamedTuple):
    """Errors of a depth image as the kernel reads them."""

    floor: float
    per_m2: float
    disparity_step: float
    parallax: float  # focal length times baseline, m px
    swapped: float  # probability that a pixel beside an edge shows the other side
    dropout: float
    min_range: float
    max_range: float


class OdometryNoise(NamedTuple):
    """Errors of the odometry as the kernel reads them."""

    scale: float
    turn_scale: float
    walk: float


def scan_noise(noise: SensorNoiseConfig, lidar: LidarConfig) -> ScanNoise:
    """The errors of a scanner. An edge lies anywhere between two rays, so a beam is cut with (width / 2) / spacing."""
    spacing = lidar.fov_rad / (lidar.num_rays - 1)
    mixed = min(1.0, noise.lidar_beam_rad / 2 / spacing)
    return ScanNoise(
        float(noise.lidar_range_share),
        float(noise.lidar_step_m),
        float(mixed),
        float(noise.lidar_dropout),
        float(lidar.min_range_m),
        float(lidar.max_range_m),
    )


def depth_noise(noise: SensorNoiseConfig, camera: CameraConfig) -> DepthNoise:
    """The errors of a depth camera.

    An edge lies anywhere between two pixels' centres and jumps by N(0, s) pixels, so that it passes a given one of
    them with probability E|N| / 2 = s / sqrt(2 pi) for s well below 1.
    """
    jitter_px = noise.camera_edge_px * camera.width / 640
    return DepthNoise(
        float(noise.camera_floor_m),
        float(noise.camera_per_m2),
        float(noise.camera_disparity_step),
        float(camera.focal_px[0] * noise.camera_baseline_m),
        float(min(0.5, jitter_px / math.sqrt(2 * math.pi))),
        float(noise.camera_dropout),
        float(camera.min_range_m),
        float(camera.max_range_m),
    )


def odometry_noise(noise: SensorNoiseConfig) -> OdometryNoise:
    """The errors of the wheels and the gyroscope."""
    return OdometryNoise(float(noise.odometry_scale), float(noise.odometry_turn_scale), float(noise.odometry_walk))


_JUMP = 0.1  # neighbouring values that differ by more than this share of the nearer one are two surfaces
_SCAN, _IMAGE, _ODOMETRY = 1, 2, 3  # one stream of random numbers each


@inner
def hash_of(key, index):
    """64 bits that look random, the same for the same key and index (splitmix64)."""
    z = np.uint64(key) + (np.uint64(index) + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@inner
def sensor_key(seed, step, stream):
    """The key of one sensor at one step of one world's episode."""
    return hash_of(hash_of(seed, step), stream)


@inner
def normal_of(bits):
    """About normal, mean 0 and variance 1, never beyond 3.5: the sum of four 16-bit uniform numbers."""
    low = np.uint64(0xFFFF)
    total = np.int64(bits & low) + np.int64((bits >> np.uint64(16)) & low)
    total += np.int64((bits >> np.uint64(32)) & low) + np.int64(bits >> np.uint64(48))
    return (total - 131070.0) / 37837.22728


@inner
def share_of(bits):
    """Uniform in [0, 1), from the upper half of the bits."""
    return np.int64(bits >> np.uint64(32)) / 4294967296.0


@inner
def _other_share(bits):
    """Uniform in [0, 1), from the lower half of the bits."""
    return np.int64(bits & np.uint64(0xFFFFFFFF)) / 4294967296.0


@inner
def _is_edge(here, there):
    return abs(here - there) > _JUMP * min(here, there)


@kernel
def spoil_scan(ranges, clean, key, noise):
    """Makes a real scan of an exact one; `clean` [rays] is scratch space. What gives no valid range is inf."""
    clean[:] = ranges
    count = ranges.shape[0]
    for r in range(count):
        exact = clean[r]
        bits = hash_of(key, 2 * r)
        if exact == np.inf or share_of(bits) < noise.dropout:
            ranges[r] = np.inf
            continue
        chance = hash_of(key, 2 * r + 1)
        value = float(exact)
        for side in (1, -1):
            if not 0 <= r + side < count:
                continue
            beyond = clean[r + side]
            cut = (share_of(chance) if side == 1 else _other_share(chance)) < noise.mixed
            if cut and beyond < np.inf and _is_edge(exact, beyond):
                value += 0.5 * _other_share(bits) * (beyond - exact)  # less than half of the beam is beyond the edge
                break
        value += noise.range_share * max(value, 1.0) * normal_of(hash_of(chance, r))
        if noise.step > 0.0:
            value = noise.step * round(value / noise.step)
        ranges[r] = value if noise.min_range <= value <= noise.max_range else np.inf


@kernel
def spoil_depth(image, key, noise):
    """Makes a real depth image of an exact one. What has no valid depth is NaN."""
    rows, width = image.shape
    for v in range(rows):
        # From right to left, because near things hide from the projector what is left of them in the image.
        covered, right = np.inf, np.nan
        for u in range(width - 1, -1, -1):
            exact = image[v, u]
            left = image[v, u - 1] if u > 0 else np.nan
            beside, right = right, exact
            if np.isnan(exact):
                continue
            projected = u - noise.parallax / exact
            hidden = projected > covered + 0.5
            covered = min(covered, projected)
            pixel = v * width + u
            bits = hash_of(key, 2 * pixel)
            if hidden or share_of(bits) < noise.dropout:
                image[v, u] = np.nan
                continue
            chance = hash_of(key, 2 * pixel + 1)
            value = float(exact)
            if _other_share(bits) < 2.0 * noise.swapped:
                other = left if share_of(chance) < 0.5 else beside
                if not np.isnan(other) and _is_edge(exact, other):
                    value = float(other)
            value += (noise.floor + noise.per_m2 * (value - 0.4) ** 2) * normal_of(hash_of(chance, u))
            if noise.disparity_step > 0.0:
                value = 1.0 / (noise.disparity_step * max(round(1.0 / (value * noise.disparity_step)), 1.0))
            image[v, u] = value if noise.min_range <= value <= noise.max_range else np.nan


@inner
def drift(odometry, last_pose, pose, key, seed, noise):
    """Moves `odometry` (x, y, yaw) as the wheels report the way from `last_pose` to `pose`; then they are equal."""
    scale = 1.0 + noise.scale * normal_of(hash_of(seed, -1))
    turn_scale = 1.0 + noise.turn_scale * normal_of(hash_of(seed, -2))
    step_x, step_y = pose[0] - last_pose[0], pose[1] - last_pose[1]
    distance = math.sqrt(step_x * step_x + step_y * step_y)
    turned = (pose[2] - last_pose[2] + math.pi) % (2.0 * math.pi) - math.pi
    # The step in the robot's frame halfway, then from the odometry's heading halfway.
    halfway = last_pose[2] + 0.5 * turned
    ahead = math.cos(halfway) * step_x + math.sin(halfway) * step_y
    aside = math.cos(halfway) * step_y - math.sin(halfway) * step_x
    measured = turn_scale * turned + noise.walk * math.sqrt(distance) * normal_of(key)
    heading = odometry[2] + 0.5 * measured
    odometry[0] += scale * (math.cos(heading) * ahead - math.sin(heading) * aside)
    odometry[1] += scale * (math.sin(heading) * ahead + math.cos(heading) * aside)
    odometry[2] = (odometry[2] + measured + math.pi) % (2.0 * math.pi) - math.pi
    for k in range(3):
        last_pose[k] = pose[k]


@kernel
def spoil(
    first, last, state, which, seeds, scans, images, odometry, last_pose, scan_errors, depth_errors, wheel_errors
):
    """Makes real what the sensors of the marked worlds measured exactly, and moves their odometry on."""
    clean = np.empty(scans.shape[1], np.float32)
    for b in range(first, last):
        if not which[b]:
            continue
        step = state.step_count[b]
        spoil_scan(scans[b], clean, sensor_key(seeds[b], step, _SCAN), scan_errors)
        spoil_depth(images[b], sensor_key(seeds[b], step, _IMAGE), depth_errors)
        if np.isnan(last_pose[b, 0]):  # the first look at an episode
            odometry[b] = state.robot_pose[b]
            last_pose[b] = state.robot_pose[b]
        key = sensor_key(seeds[b], step, _ODOMETRY)
        drift(odometry[b], last_pose[b], state.robot_pose[b], key, seeds[b], wheel_errors)
