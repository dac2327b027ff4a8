"""What every predictor takes and gives: histories of tracks in, Gaussians at some horizons out. No predictor itself."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int

from densecavoid.frames import require

ROBOT_HORIZONS_S = (0.1, 0.4, 0.8, 1.2)
"""What the prediction frame asks for."""
ROBOT_PERIOD_S, ROBOT_SAMPLES = 0.1, 32
"""The tracker keeps a place of each track every .1 s, for 3.2 s."""
FIELD_PERIOD_S, FIELD_SEEN, FIELD_PREDICTED = 0.4, 8, 12
"""ETH/UCY as the field measures it."""


class Histories(NamedTuple):
    """Tracks of one or many worlds at one instant, in any frame that does not move (odometry, world)."""

    pos: Float[np.ndarray, "N H 2"]
    """Places, m; the last one is now, the others a period apart. What is not valid may hold anything."""
    valid: Bool[np.ndarray, "N H"]
    """Whether there is a place. A track without a place now has no prediction (NaN)."""
    group: Int[np.ndarray, "N"]
    """Which world (or instant) a track is of: only tracks of one group see each other. Rows of one group adjoin."""
    velocity: Float[np.ndarray, "N 2"]
    """The tracker's filtered velocity now, m/s; NaN: to be found from the places."""
    period_s: float
    """Time between two places."""


class Prediction(NamedTuple):
    """A Gaussian for each track and horizon."""

    mean: Float[np.ndarray, "N S 2"]
    """m, in the frame of the histories."""
    covariance: Float[np.ndarray, "N S 3"]
    """xx, xy, yy in m2."""


@runtime_checkable
class Predictor(Protocol):
    """One way of predicting. Stateless between calls."""

    @property
    def name(self) -> str:
        """As in `registry.PREDICTORS` and in tables."""
        ...

    def predict(self, histories: Histories, horizons_s: Sequence[float]) -> Prediction:
        """Where everybody will be.

        Args:
            histories: of N tracks; N may be 0.
            horizons_s: S times ahead of now, s.
        """
        ...


def histories_of(
    pos: Float[np.ndarray, "N H 2"],
    period_s: float,
    valid: Bool[np.ndarray, "N H"] | None = None,
    group: Int[np.ndarray, "N"] | None = None,
    velocity: Float[np.ndarray, "N 2"] | None = None,
) -> Histories:
    """Checked histories; what is left out: all finite places are valid, one group, velocity to be found.

    Raises:
        ValueError: naming what does not fit, or rows of one group that do not adjoin.
    """
    require(period_s > 0, "period_s", period_s, "above 0 s")
    finite = np.all(np.isfinite(pos), axis=2)
    count = len(pos)
    group = np.zeros(count, np.int64) if group is None else group
    if count:
        starts = np.flatnonzero(np.diff(group)) + 1
        first = group[np.concatenate([[0], starts])]
        require(len(np.unique(first)) == len(first), "Histories.group", group, "rows of one group to adjoin")
    return Histories(
        pos=pos,
        valid=finite if valid is None else valid & finite,
        group=group,
        velocity=np.full((count, 2), np.nan) if velocity is None else velocity,
        period_s=period_s,
    )


def check_horizons(horizons_s: Sequence[float], longest_s: float = 60.0) -> Float[np.ndarray, "S"]:
    """
    Raises:
        ValueError: if a horizon is not from 0 (not included) to `longest_s`.
    """
    horizons = np.asarray(horizons_s, np.float64)
    known = horizons.ndim == 1 and len(horizons) > 0 and bool(((horizons > 0) & (horizons <= longest_s + 1e-9)).all())
    require(known, "horizons_s", tuple(horizons_s), f"times above 0, at most {longest_s:g} s")
    return horizons
