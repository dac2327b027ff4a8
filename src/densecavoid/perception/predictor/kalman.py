"""The tracker's Kalman filter over whole histories, and what it expects then: velocity wanders by white acceleration,
places carry white noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from densecavoid.frames import require
from densecavoid.perception.kalman import kalman_correct, kalman_predict
from densecavoid.perception.predictor.contract import Histories, Prediction, check_horizons
from densecavoid.sim._jit import kernel


@kernel
def filter_tracks(pos, valid, period_s, acceleration_std, measurement_std, speed_std, states, covs):
    """Filters N histories forward; before the first valid place there is nothing, after it misses are bridged.

    Args:
        pos: [N, H, 2] measured places, m. valid: [N, H].
        acceleration_std: m/s2. measurement_std: m. speed_std: m/s, of a velocity not known yet.
        states: out [N, H, 4] x, y, vx, vy after each step; NaN before the first valid place.
        covs: out [N, H, 3] variances of place, place-velocity, velocity.
    """
    state, cov = np.empty(4), np.empty(3)
    for n in range(pos.shape[0]):
        started = False
        for h in range(pos.shape[1]):
            if started:
                kalman_predict(state, cov, period_s, acceleration_std)
                if valid[n, h]:
                    kalman_correct(state, cov, pos[n, h, 0], pos[n, h, 1], measurement_std)
            elif valid[n, h]:
                started = True
                state[0], state[1], state[2], state[3] = pos[n, h, 0], pos[n, h, 1], 0.0, 0.0
                cov[0], cov[1], cov[2] = measurement_std * measurement_std, 0.0, speed_std * speed_std
            for k in range(4):
                states[n, h, k] = state[k] if started else np.nan
            for k in range(3):
                covs[n, h, k] = cov[k] if started else np.nan


@dataclass(frozen=True)
class KalmanPredictor:
    """Constant velocity from a filter, with the covariance that the filter's own model gives."""

    acceleration_std: float = 0.5
    """How people's velocity wanders, m/s2. The value (and the next) that does best on ETH/UCY at .4 s."""
    measurement_std: float = 0.05
    """m"""
    speed_std: float = 1.0
    """m/s, of a velocity not known yet."""
    name: str = "kalman"

    def __post_init__(self) -> None:
        for field in ("acceleration_std", "measurement_std", "speed_std"):
            require(getattr(self, field) > 0, f"KalmanPredictor.{field}", getattr(self, field), "above 0")

    def filter(self, histories: Histories) -> tuple[np.ndarray, np.ndarray]:
        """States [N, H, 4] (x, y, vx, vy) and covariances [N, H, 3] (place, place-velocity, velocity) at each step."""
        count, steps = histories.valid.shape
        states, covs = np.empty((count, steps, 4)), np.empty((count, steps, 3))
        filter_tracks(
            np.ascontiguousarray(histories.pos, np.float64),
            np.ascontiguousarray(histories.valid),
            float(histories.period_s),
            float(self.acceleration_std),
            float(self.measurement_std),
            float(self.speed_std),
            states,
            covs,
        )
        return states, covs

    def predict(self, histories: Histories, horizons_s: Sequence[float]) -> Prediction:
        """As `Predictor.predict`. A velocity that was handed over is taken where there is one place only."""
        horizons = check_horizons(horizons_s)
        states, covs = self.filter(histories)
        state, (pp, pv, vv) = states[:, -1], covs[:, -1].T
        here = histories.valid[:, -1]
        single = (histories.valid.sum(axis=1) == 1) & np.isfinite(histories.velocity).all(axis=1)
        velocity = np.where(single[:, None], histories.velocity, state[:, 2:])
        mean = state[:, None, :2] + velocity[:, None] * horizons[:, None]
        h = horizons[None, :]
        variance = (
            pp[:, None]
            + 2.0 * h * pv[:, None]
            + h**2 * vv[:, None]
            + self.acceleration_std**2 * h**3 * histories.period_s / 4.0 * _growth(h / histories.period_s)
        )
        covariance = np.stack([variance, np.zeros_like(variance), variance], axis=2)
        mean[~here], covariance[~here] = np.nan, np.nan
        return Prediction(mean, covariance)


def _growth(steps: np.ndarray) -> np.ndarray:
    """n steps of piecewise constant acceleration add q dt^4 (4 n^3 - n) / 12 to a place's variance: (4 - 1 / n^2) / 3,
    without q dt^4 n^3 / 4. Nothing below half a step."""
    return np.maximum(4.0 - 1.0 / steps**2, 0.0) / 3.0
