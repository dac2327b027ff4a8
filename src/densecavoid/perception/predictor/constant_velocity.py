"""Everybody goes on as they went in the last .4 s: the field's hardest baseline to beat."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from densecavoid.frames import require
from densecavoid.perception.predictor.contract import Histories, Prediction, check_horizons


@dataclass(frozen=True)
class ConstantVelocity:
    """From the tracker's velocity where there is one, else from the places `over_s` apart (or as far as they reach)."""

    over_s: float = 0.4
    position_std_m: float = 0.05
    """Of a place now. This and the next put about half of the truths into the 50 % ellipse for tracks with a tracker's
    errors; for recorded places they are too wide."""
    speed_std: float = 0.2
    """m/s; grows the standard deviation linearly."""
    unknown_speed_std: float = 1.0
    """m/s; the same for a track with one place and no velocity, which is taken to stand."""
    name: str = "constant-velocity"

    def __post_init__(self) -> None:
        for field in ("over_s", "position_std_m", "speed_std", "unknown_speed_std"):
            require(getattr(self, field) > 0, f"ConstantVelocity.{field}", getattr(self, field), "above 0")

    def predict(self, histories: Histories, horizons_s: Sequence[float]) -> Prediction:
        """As `Predictor.predict`."""
        horizons = check_horizons(horizons_s)
        velocity, known = self.velocity(histories)
        here = histories.valid[:, -1]
        now = np.where(here[:, None], histories.pos[:, -1], np.nan)
        mean = now[:, None] + velocity[:, None] * horizons[:, None]
        speed_std = np.where(known, self.speed_std, self.unknown_speed_std)
        variance = self.position_std_m**2 + (speed_std[:, None] * horizons) ** 2
        covariance = np.stack([variance, np.zeros_like(variance), variance], axis=2)
        covariance[~here] = np.nan
        return Prediction(mean, covariance)

    def velocity(self, histories: Histories) -> tuple[Float[np.ndarray, "N 2"], Bool[np.ndarray, "N"]]:
        """Velocities (m/s; 0 where unknown), and which are known."""
        given: np.ndarray = np.all(np.isfinite(histories.velocity), axis=1)
        if given.all():  # as from a tracker
            return histories.velocity.astype(np.float64), given
        count, steps = histories.valid.shape
        reach = min(max(round(self.over_s / histories.period_s), 1), steps - 1)
        velocity, known = np.zeros((count, 2)), np.zeros(count, np.bool_)
        for back in range(1, reach + 1):  # the longest stretch that is there has the last word
            both = histories.valid[:, -1] & histories.valid[:, -1 - back]
            velocity[both] = (histories.pos[both, -1] - histories.pos[both, -1 - back]) / (back * histories.period_s)
            known |= both
        velocity[given] = histories.velocity[given]
        return velocity, known | given
