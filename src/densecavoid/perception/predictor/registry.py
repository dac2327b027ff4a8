"""Predictors by name, for pipelines, trainings and tables."""

from __future__ import annotations

from collections.abc import Callable

from densecavoid.frames import choose
from densecavoid.perception.predictor.constant_velocity import ConstantVelocity
from densecavoid.perception.predictor.contract import Predictor
from densecavoid.perception.predictor.kalman import KalmanPredictor
from densecavoid.perception.predictor.learned import LearnedPredictor

PREDICTORS: dict[str, Callable[[], Predictor]] = {
    "constant-velocity": ConstantVelocity,
    "kalman": lambda: KalmanPredictor(acceleration_std=1.0),
    "robust-tp": lambda: LearnedPredictor("predictor-robust-tp-robot"),
    "compact": lambda: LearnedPredictor("predictor-compact-robot"),
}
"""For a robot: histories of .1 s steps, horizons up to 1.2 s (the first two: any)."""


def make_predictor(name: str) -> Predictor:
    """The predictor of that name, as robots use it.

    Raises:
        ValueError: if there is none, saying what there is.
        FileNotFoundError: if its weights are not there.
    """
    return PREDICTORS[choose("predictor", name, tuple(PREDICTORS))]()
