"""What tracking and finding legs cost, by how many people there are."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float, Float32

from densecavoid.frames import CameraConfig, LidarConfig
from densecavoid.perception.detections import Detections, allocate_detections
from densecavoid.perception.legs import LegDetector
from densecavoid.perception.tracker import Sighting, Tracker
from densecavoid.perception.visibility import depth_view, lidar_view

NUM_PEOPLE = (2, 4, 8, 16, 32)
_SPACING_M = 0.75
_LEG_M, _HALF_STRIDE_M = 0.06, 0.14


def crowd(count: int) -> Float[np.ndarray, "count 2"]:
    """People on a grid around the robot, nearest first."""
    steps = np.arange(-5, 6)
    grid = _SPACING_M * np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2).astype(float)
    distance = np.hypot(*grid.T)
    order = np.argsort(distance, kind="stable")
    return grid[order[distance[order] > 0.9]][:count]


def scan_of_legs(places: Float[np.ndarray, "n 2"], lidar: LidarConfig) -> Float32[np.ndarray, "rays"]:
    """Ranges to two discs a person, before nothing."""
    ranges = np.full(lidar.num_rays, np.inf)
    for side in (-_HALF_STRIDE_M, _HALF_STRIDE_M):
        for x, y in np.add(places, (0.0, side)):
            along = x * np.cos(lidar.angles_rad) + y * np.sin(lidar.angles_rad)
            across = x * np.sin(lidar.angles_rad) - y * np.cos(lidar.angles_rad)
            hit = (np.abs(across) < _LEG_M) & (along > 0)
            ranges[hit] = np.minimum(ranges[hit], (along - np.sqrt(np.maximum(_LEG_M**2 - across**2, 0.0)))[hit])
    ranges[ranges > lidar.max_range_m] = np.inf
    return ranges.astype(np.float32)


def _median_us(each: Callable[[int], object], repeats: int, worlds: int) -> float:
    times = np.empty(repeats)
    for k in range(-5, repeats):  # the first few compile, and fill caches
        start = time.perf_counter()
        each(k)
        if k >= 0:
            times[k] = time.perf_counter() - start
    return float(np.median(times) / worlds * 1e6)


def tracking_cost(
    num_people: Sequence[int] = NUM_PEOPLE, worlds: int = 64, repeats: int = 40
) -> dict[str, dict[str, float]]:
    """Median microseconds on one thread, by number of people: `tracker_us` for each world and update with a camera's
    and a lidar's detections of everybody, `legs_us` for each scan, `tracker_alone_us` in a batch of one.

    People stand around the robot and are found with errors of 5 cm.
    """
    lidar, camera = LidarConfig(), CameraConfig()
    cost: dict[str, dict[str, float]] = {"tracker_us": {}, "tracker_alone_us": {}, "legs_us": {}}
    for count in num_people:
        places, name = crowd(count), str(count)
        cost["tracker_us"][name] = _tracker_us(places, worlds, repeats, lidar, camera)
        cost["tracker_alone_us"][name] = _tracker_us(places, 1, repeats, lidar, camera)
        scans, pose = np.tile(scan_of_legs(places, lidar), (worlds, 1)), np.zeros((worlds, 3))
        detector = LegDetector(lidar, worlds, 1)
        cost["legs_us"][name] = _median_us(lambda _: detector.detect(scans, pose), repeats, worlds)  # noqa: B023
    return cost


def _tracker_us(
    places: Float[np.ndarray, "n 2"], worlds: int, repeats: int, lidar: LidarConfig, camera: CameraConfig
) -> float:
    rng, tracker, pose = np.random.default_rng(0), Tracker(worlds, 1), np.zeros((worlds, 3))
    depth = depth_view(np.full((worlds, camera.height, camera.width), 4.99, np.float32), camera)
    scan = lidar_view(np.tile(scan_of_legs(places, lidar), (worlds, 1)), lidar)

    def found() -> Detections:
        detections = allocate_detections(worlds)
        detections.count[:] = len(places)
        detections.pos[:, : len(places)] = places + rng.normal(0.0, 0.05, (worlds, len(places), 2))
        detections.std_m[:], detections.confidence[:] = 0.05, 0.9
        return detections

    several = [[Sighting(found(), depth), Sighting(found(), scan)] for _ in range(repeats + 5)]
    return _median_us(lambda k: tracker.update(pose, 0.1, several[k]), repeats, worlds)
