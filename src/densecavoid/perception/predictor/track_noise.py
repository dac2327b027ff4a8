"""Makes of true walks what a tracker would hand over: jitter, drifting bias, misses, late births, switched identities,
then the tracker's own filter. For training and measuring predictors on tracks as a robot has them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from densecavoid.frames import require
from densecavoid.perception.predictor.contract import Histories
from densecavoid.perception.predictor.kalman import KalmanPredictor
from densecavoid.perception.predictor.windows import Windows

TRACKER_FILTER = KalmanPredictor(acceleration_std=1.0, measurement_std=0.05, speed_std=1.0)
"""As the tracker's was when the predictors that ship were trained: one model; now it has two."""
_BIAS_TIME_S = 0.5  # a person's visible side changes over about a step
_SWITCH_REACH_M = 1.0


@dataclass(frozen=True)
class TrackNoise:
    """How far tracks are from the truth. Each track draws its own jitter, bias and rate of misses, up to these."""

    jitter_std_m: float = 0.10
    """From image to image."""
    bias_std_m: float = 0.05
    """Drifting within about half a second."""
    miss_rate: float = 0.3
    """Share of steps without a detection."""
    late_share: float = 0.4
    """Of tracks that were born within the history."""
    switch_share: float = 0.03
    """Of tracks whose older part is that of somebody else, at most 1 m away."""

    def __post_init__(self) -> None:
        for name in ("jitter_std_m", "bias_std_m"):
            require(0 <= getattr(self, name) <= 1, f"TrackNoise.{name}", getattr(self, name), "in [0, 1] m")
        for name in ("miss_rate", "late_share", "switch_share"):
            require(0 <= getattr(self, name) <= 1, f"TrackNoise.{name}", getattr(self, name), "in [0, 1]")


def as_tracked(windows: Windows, noise: TrackNoise, rng: np.random.Generator) -> Windows:
    """The windows with the histories and velocities that a tracker would have; the futures stay true."""
    count, steps = windows.valid.shape
    pos = _switched(windows, noise.switch_share, rng)
    born = np.where(rng.random(count) < noise.late_share, rng.integers(0, steps, count), 0)
    valid = windows.valid & (np.arange(steps) >= born[:, None])
    valid[:, -1] = windows.valid[:, -1]

    jitter = rng.uniform(0, noise.jitter_std_m, (count, 1, 1)) * rng.standard_normal(pos.shape)
    bias = rng.uniform(0, noise.bias_std_m, (count, 1, 1)) * _drift(rng, pos.shape, windows.period_s)
    first = np.arange(steps) == valid.argmax(axis=1)[:, None]
    missed = rng.random((count, steps)) < rng.uniform(0, noise.miss_rate, (count, 1))
    seen = valid & (~missed | first)

    states, _ = TRACKER_FILTER.filter(
        Histories(pos + jitter + bias, seen, windows.group, np.full((count, 2), np.nan), windows.period_s)
    )
    return replace(
        windows,
        pos=states[..., :2].astype(np.float32),
        valid=np.isfinite(states[..., 0]),
        velocity=states[:, -1, 2:].astype(np.float32),
    )


def jittered(windows: Windows, std_m: float, rng: np.random.Generator) -> Windows:
    """White noise on the places of half the tracks, without a tracker: mostly little, up to `std_m`.

    Recordings differ: clicked tracks are smooth, others jump by centimetres, and what is right for one is wrong for the
    other. With both before it, a network learns to tell them apart.
    """
    std = std_m * rng.random((len(windows), 1, 1)) ** 2 * (rng.random((len(windows), 1, 1)) < 0.5)
    return replace(windows, pos=(windows.pos + std * rng.standard_normal(windows.pos.shape)).astype(np.float32))


def _drift(rng: np.random.Generator, shape: tuple[int, ...], period_s: float) -> Float[np.ndarray, "N H 2"]:
    """First-order autoregressive noise of unit variance."""
    keep = float(np.exp(-period_s / _BIAS_TIME_S))
    drift = rng.standard_normal(shape)
    for step in range(1, shape[1]):
        drift[:, step] = keep * drift[:, step - 1] + np.sqrt(1.0 - keep**2) * drift[:, step]
    return drift


def _switched(windows: Windows, share: float, rng: np.random.Generator) -> Float[np.ndarray, "N H 2"]:
    """Places where some tracks took over a neighbour's past: until the step of the switch they were the neighbour."""
    pos = windows.pos.astype(np.float64)
    count, steps = windows.valid.shape
    partner = _partners(windows, rng)
    when = rng.integers(1, steps, count)
    row = np.arange(count)
    apart = np.linalg.norm(windows.pos[row, when] - windows.pos[partner, when], axis=1)
    switches = (rng.random(count) < share) & (apart < _SWITCH_REACH_M)  # NaN is not near
    for n in np.flatnonzero(switches & (partner != row)):
        pos[n, : when[n]] = windows.pos[partner[n], : when[n]]
    return pos


def _partners(windows: Windows, rng: np.random.Generator) -> Int[np.ndarray, "N"]:
    """Somebody of the same group for each, at random; rows of a group adjoin."""
    starts: Bool[np.ndarray, "N"] = np.diff(windows.group, prepend=windows.group[:1] - 1) != 0
    first = np.flatnonzero(starts)
    size = np.diff(np.append(first, len(windows)))
    of = np.cumsum(starts) - 1
    return first[of] + (rng.random(len(windows)) * size[of]).astype(np.int64)
