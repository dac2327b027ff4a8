"""What a detector hands to the tracker: places of people and how far to trust them, from camera, lidar or both."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

MAX_DETECTIONS = 32
"""In one world at one instant."""


class Detections(NamedTuple):
    """People found in each world at one instant. Slots from `count` on hold no meaning."""

    pos: np.ndarray  # f64 [B, D, 2] x, y in the odometry frame, m
    std_m: np.ndarray  # f64 [B, D] standard deviation of x and of y
    body: np.ndarray  # f64 [B, D, 2] radius, height in m; NaN where the sensor cannot tell
    confidence: np.ndarray  # f64 [B, D] in [0, 1], that it is a person
    count: np.ndarray  # i32 [B]  # pyright: ignore[reportIncompatibleMethodOverride]


def allocate_detections(num_worlds: int) -> Detections:
    """Room for `MAX_DETECTIONS` a world, none found."""
    return Detections(
        pos=np.zeros((num_worlds, MAX_DETECTIONS, 2)),
        std_m=np.zeros((num_worlds, MAX_DETECTIONS)),
        body=np.full((num_worlds, MAX_DETECTIONS, 2), np.nan),
        confidence=np.zeros((num_worlds, MAX_DETECTIONS)),
        count=np.zeros(num_worlds, np.int32),
    )
