"""Predictors by name, for pipelines, trainings and tables."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from densecavoid.frames import choose, require
from densecavoid.perception.predictor.constant_velocity import ConstantVelocity
from densecavoid.perception.predictor.contract import Predictor
from densecavoid.perception.predictor.kalman import KalmanPredictor
from densecavoid.perception.predictor.learned import LearnedPredictor

SHIPPED_WEIGHTS = {"robust-tp": "predictor-robust-tp-robot", "compact": "predictor-compact-robot"}
"""Of predictors that have weights."""
PREDICTORS: dict[str, Callable[[], Predictor]] = {
    "constant-velocity": ConstantVelocity,
    "kalman": lambda: KalmanPredictor(acceleration_std=1.0),
    "robust-tp": partial(LearnedPredictor, SHIPPED_WEIGHTS["robust-tp"]),
    "compact": partial(LearnedPredictor, SHIPPED_WEIGHTS["compact"]),
}
"""For a robot: histories of .1 s steps, horizons up to 1.2 s (the first two: any)."""


def make_predictor(name: str, weights: str | Path | None = None) -> Predictor:
    """The predictor of that name, as robots use it.

    Args:
        name: one of `PREDICTORS`.
        weights: a shipped network's name or an ONNX file, instead of the one that ships for it.

    Raises:
        ValueError: if there is none, saying what there is, or the weights are another predictor's.
        FileNotFoundError: if its weights are not there.
    """
    choose("predictor", name, tuple(PREDICTORS))
    if weights is None:
        return PREDICTORS[name]()
    predictor = LearnedPredictor(weights)
    require(predictor.card.kind == name, f"kind of {weights}", predictor.card.kind, repr(name))
    return predictor
