"""Learned predictors as benchmarks and robots run them: features in NumPy and numba, an ONNX file in ONNX Runtime."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float, Float32

from densecavoid.frames import require
from densecavoid.networks.onnx_files import Shelf
from densecavoid.perception.predictor.card import INPUTS, PredictorCard
from densecavoid.perception.predictor.contract import Histories, Prediction, check_horizons
from densecavoid.perception.predictor.features import compute_features
from densecavoid.perception.predictor.grids import compute_grids
from densecavoid.perception.predictor.kalman import KalmanPredictor
from densecavoid.sim._jit import kernel

LEARNED = Shelf("predictor", "densecavoid.perception", "predictor-")
"""The learned ones that come with the package."""


def network_inputs(
    card: PredictorCard, histories: Histories
) -> tuple[tuple[np.ndarray, ...], Float[np.ndarray, "N 2"], Float[np.ndarray, "N 2"]]:
    """What the network of a card takes, with the velocities and directions that its outputs relate to.

    Raises:
        ValueError: if the histories' period is not the card's.
    """
    same = abs(histories.period_s - card.period_s) < 1e-9
    require(same, "Histories.period_s", histories.period_s, f"{card.period_s} s for {card.name!r}")
    base = KalmanPredictor(card.base_acceleration_std, card.base_measurement_std)
    compute = compute_features if card.kind == "compact" else compute_grids
    features = compute(fit_length(histories, card.samples), base)
    return tuple(features[:-2]), features.velocity, features.direction


def fit_length(histories: Histories, samples: int) -> Histories:
    """The last so many places; what is missing before the first is not valid."""
    have = histories.valid.shape[1]
    if have >= samples:
        return histories._replace(pos=histories.pos[:, have - samples :], valid=histories.valid[:, have - samples :])
    missing = [(0, 0), (samples - have, 0)]
    return histories._replace(
        pos=np.pad(histories.pos, [*missing, (0, 0)]), valid=np.pad(histories.valid, missing, constant_values=False)
    )


def every(histories: Histories, period_s: float) -> Histories:
    """The histories at a longer period, now included.

    Raises:
        ValueError: if it is not a multiple of theirs.
    """
    ratio = period_s / histories.period_s
    whole = abs(ratio - round(ratio)) < 1e-6 and ratio > 0.5
    require(whole, "Histories.period_s", histories.period_s, f"{period_s} s over a whole number")
    step = round(ratio)
    pick = slice((histories.valid.shape[1] - 1) % step, None, step)
    return histories._replace(pos=histories.pos[:, pick], valid=histories.valid[:, pick], period_s=period_s)


def to_world(
    raw: Float32[np.ndarray, "N T 5"],
    card: PredictorCard,
    horizons_s: Float[np.ndarray, "S"],
    now: Float[np.ndarray, "N 2"],
    velocity: Float[np.ndarray, "N 2"],
    direction: Float[np.ndarray, "N 2"],
) -> Prediction:
    """Corrections ahead and left as Gaussians in the frame of the histories.

    Between the network's horizons the correction and the standard deviations are interpolated (from 0 and a third of
    the first ones at the instant itself).
    """
    mean = np.empty((len(raw), len(horizons_s), 2))
    covariance = np.empty((len(raw), len(horizons_s), 3))
    knots, temperature = np.asarray(card.horizons_s), np.asarray(card.temperature)
    _write_world(np.ascontiguousarray(raw), knots, temperature, horizons_s, now, velocity, direction, mean, covariance)
    return Prediction(mean, covariance)


@kernel
def _write_world(raw, knots, temperature, horizons_s, now, velocity, direction, mean, covariance):
    """Fills `mean` and `covariance`; see `to_world`."""
    for s in range(len(horizons_s)):
        horizon = horizons_s[s]
        after = 0
        while after < len(knots) - 1 and horizon > knots[after] + 1e-9:
            after += 1
        before = max(after - 1, 0)
        begin = knots[before] if after > 0 else 0.0
        share = (horizon - begin) / (knots[after] - begin)
        # Before the first of the network's horizons: no correction, a third of its standard deviations.
        mean_before, std_before = 1.0 - share, (1.0 - share) * temperature[before]
        if after == 0:
            mean_before, std_before = 0.0, std_before / 3.0
        std_after = share * temperature[after]
        for n in range(len(raw)):
            first, last = raw[n, before], raw[n, after]
            ahead, left = mean_before * first[0] + share * last[0], mean_before * first[1] + share * last[1]
            std_ahead = std_before * first[2] + std_after * last[2]
            std_left = std_before * first[3] + std_after * last[3]
            correlation = (1.0 - share) * first[4] + share * last[4]
            cos, sin = direction[n, 0], direction[n, 1]
            mean[n, s, 0] = now[n, 0] + velocity[n, 0] * horizon + cos * ahead - sin * left
            mean[n, s, 1] = now[n, 1] + velocity[n, 1] * horizon + sin * ahead + cos * left
            aa, ll, al = std_ahead * std_ahead, std_left * std_left, correlation * std_ahead * std_left
            covariance[n, s, 0] = cos * cos * aa - 2.0 * cos * sin * al + sin * sin * ll
            covariance[n, s, 1] = cos * sin * (aa - ll) + (cos * cos - sin * sin) * al
            covariance[n, s, 2] = sin * sin * aa + 2.0 * cos * sin * al + cos * cos * ll


class LearnedPredictor:
    """A predictor from a file. Stateless between calls."""

    def __init__(self, name_or_path: str | Path, threads: int = 1) -> None:
        """Loads and checks the file.

        Args:
            name_or_path: a shipped predictor's name or an ONNX file.
            threads: of one call.

        Raises:
            FileNotFoundError: if there is no such predictor.
            ValueError: if the file is not a predictor of this project.
        """
        opened = LEARNED.open(name_or_path, threads)
        self._session, self.sha256 = opened.session, opened.sha256
        self.card = PredictorCard.from_metadata(opened.metadata, f"the file of predictor {str(name_or_path)!r}")
        self.name = self.card.name
        self._inputs = [node.name for node in self._session.get_inputs()]
        expected = list(INPUTS[self.card.kind])
        require(self._inputs == expected, f"inputs of {name_or_path}", self._inputs, f"{expected}")

    def predict(self, histories: Histories, horizons_s: Sequence[float]) -> Prediction:
        """As `Predictor.predict`. Histories of a shorter period are thinned to the card's.

        Raises:
            ValueError: if a horizon is beyond the card's, or the histories' period does not fit.
        """
        horizons = check_horizons(horizons_s, self.card.horizons_s[-1])
        histories = every(histories, self.card.period_s)
        here = histories.valid[:, -1]
        inputs, velocity, direction = network_inputs(self.card, histories)
        raw = self.run(inputs)
        now = np.where(here[:, None], histories.pos[:, -1], np.nan).astype(np.float64)
        prediction = to_world(raw, self.card, horizons, now, velocity, direction)
        prediction.covariance[~here] = np.nan
        return prediction

    def run(self, inputs: tuple[np.ndarray, ...]) -> Float32[np.ndarray, "N T 5"]:
        """The network alone."""
        if not len(inputs[0]):
            return np.zeros((0, len(self.card.horizons_s), 5), np.float32)
        return np.asarray(self._session.run(None, dict(zip(self._inputs, inputs, strict=True)))[0])
