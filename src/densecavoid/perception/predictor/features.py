"""What the compact predictor looks at: a track's own past and its nearest neighbours, in its own walking direction.

Everything is relative to constant velocity, so that a straight walk is all zeros and the network has only the deviation
to explain. Turning or moving the world changes nothing; mirroring it changes the sign of every second number.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from densecavoid.perception.predictor.contract import Histories
from densecavoid.perception.predictor.kalman import KalmanPredictor
from densecavoid.sim._jit import inner, kernel

NEIGHBOURS = 8
"""The nearest within `REACH_M`; more change nothing that was measured."""
REACH_M = 6.0
NEIGHBOUR_NUMBERS = 5
"""x, y ahead and left, m; velocity relative to the track's own, m/s; 1 where there is a neighbour."""
MIN_SPEED = 0.05
"""m/s; who is slower has no walking direction, and is seen in that of the world."""


class Features(NamedTuple):
    """Inputs of the network, and what its outputs relate to."""

    own: np.ndarray  # f32 [N, 3 (H - 1) + 1] deviation x, deviation y and validity of each past place; speed
    neighbours: np.ndarray  # f32 [N, NEIGHBOURS, NEIGHBOUR_NUMBERS]
    velocity: np.ndarray  # f64 [N, 2] of the constant-velocity line, m/s
    direction: np.ndarray  # f64 [N, 2] cosine and sine of the walking direction


def own_size(samples: int) -> int:
    """Numbers about the own past, of histories of so many places."""
    return 3 * (samples - 1) + 1


@inner
def _write_own(own, pos, valid, velocity, direction, n, period_s):
    samples = pos.shape[1]
    cos, sin = direction[n, 0], direction[n, 1]
    x, y, vx, vy = pos[n, samples - 1, 0], pos[n, samples - 1, 1], velocity[n, 0], velocity[n, 1]
    for back in range(1, samples):
        k = 3 * (back - 1)
        if valid[n, samples - 1 - back]:
            off_x = pos[n, samples - 1 - back, 0] - x + vx * back * period_s
            off_y = pos[n, samples - 1 - back, 1] - y + vy * back * period_s
            own[n, k] = cos * off_x + sin * off_y
            own[n, k + 1] = cos * off_y - sin * off_x
            own[n, k + 2] = 1.0
        else:
            own[n, k] = own[n, k + 1] = own[n, k + 2] = 0.0
    own[n, 3 * (samples - 1)] = math.sqrt(vx * vx + vy * vy)


@kernel
def _write_features(pos, valid, group, velocity, period_s, own, neighbours, direction):
    """Fills `own`, `neighbours` and `direction`; see `Features`."""
    count, samples = valid.shape
    near = np.empty(NEIGHBOURS, np.int64)
    distance = np.empty(NEIGHBOURS)
    first = 0
    for n in range(count):
        speed = math.sqrt(velocity[n, 0] ** 2 + velocity[n, 1] ** 2)
        direction[n, 0] = velocity[n, 0] / speed if speed > MIN_SPEED else 1.0
        direction[n, 1] = velocity[n, 1] / speed if speed > MIN_SPEED else 0.0
        if group[n] != group[first]:
            first = n
        for k in range(NEIGHBOURS):
            for number in range(NEIGHBOUR_NUMBERS):
                neighbours[n, k, number] = 0.0
        if not valid[n, samples - 1]:
            own[n] = 0.0
            continue
        _write_own(own, pos, valid, velocity, direction, n, period_s)

        x, y = pos[n, samples - 1, 0], pos[n, samples - 1, 1]
        found = 0
        m = first
        while m < count and group[m] == group[n]:
            off_x, off_y = pos[m, samples - 1, 0] - x, pos[m, samples - 1, 1] - y
            square = off_x * off_x + off_y * off_y
            if m != n and valid[m, samples - 1] and square < REACH_M * REACH_M:
                k = min(found, NEIGHBOURS - 1)
                if found < NEIGHBOURS or square < distance[k]:
                    while k > 0 and distance[k - 1] > square:
                        distance[k], near[k] = distance[k - 1], near[k - 1]
                        k -= 1
                    distance[k], near[k] = square, m
                    found = min(found + 1, NEIGHBOURS)
            m += 1
        cos, sin = direction[n, 0], direction[n, 1]
        for k in range(found):
            m = near[k]
            off_x, off_y = pos[m, samples - 1, 0] - x, pos[m, samples - 1, 1] - y
            slip_x, slip_y = velocity[m, 0] - velocity[n, 0], velocity[m, 1] - velocity[n, 1]
            neighbours[n, k, 0] = cos * off_x + sin * off_y
            neighbours[n, k, 1] = cos * off_y - sin * off_x
            neighbours[n, k, 2] = cos * slip_x + sin * slip_y
            neighbours[n, k, 3] = cos * slip_y - sin * slip_x
            neighbours[n, k, 4] = 1.0


def as_kernels_read(histories: Histories) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places, their validity and groups."""
    return (
        np.ascontiguousarray(histories.pos, np.float64),
        np.ascontiguousarray(histories.valid),
        np.ascontiguousarray(histories.group, np.int64),
    )


def base_velocity(histories: Histories, base: KalmanPredictor) -> np.ndarray:
    """[N, 2] of the constant-velocity line: the tracker's, or `base`'s where there is none; 0 without any place."""
    velocity = np.array(histories.velocity, np.float64)
    unknown = ~np.isfinite(velocity).all(axis=1)
    if unknown.any():
        states, _ = base.filter(histories._replace(pos=histories.pos[unknown], valid=histories.valid[unknown]))
        velocity[unknown] = np.nan_to_num(states[:, -1, 2:])
    return velocity


def compute_features(histories: Histories, base: KalmanPredictor) -> Features:
    """Features of all tracks; the constant-velocity line is the tracker's, or `base`'s where there is none."""
    count, samples = histories.valid.shape
    velocity = base_velocity(histories, base)
    own = np.empty((count, own_size(samples)), np.float32)
    neighbours = np.empty((count, NEIGHBOURS, NEIGHBOUR_NUMBERS), np.float32)
    direction = np.empty((count, 2))
    period_s = float(histories.period_s)
    _write_features(*as_kernels_read(histories), velocity, period_s, own, neighbours, direction)
    return Features(own, neighbours, velocity, direction)
