"""Whether predicted Gaussians are as wide as their errors."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from densecavoid.perception.predictor.contract import Prediction

INSIDE_HALF = 2.0 * math.log(2.0)
"""Squared Mahalanobis distance within which half of a Gaussian in the plane lies."""


def mahalanobis_square(prediction: Prediction, truth: Float[np.ndarray, "N S 2"]) -> Float[np.ndarray, "N S"]:
    """Of the truths; NaN where there is none."""
    x, y = np.moveaxis(truth - prediction.mean, 2, 0)
    xx, xy, yy = np.moveaxis(prediction.covariance, 2, 0)
    return (yy * x**2 - 2.0 * xy * x * y + xx * y**2) / (xx * yy - xy**2)


def negative_log_likelihood(prediction: Prediction, truth: Float[np.ndarray, "N S 2"]) -> Float[np.ndarray, "N S"]:
    """Of the truths under the bivariate Gaussians, in nats (density per m2)."""
    xx, xy, yy = np.moveaxis(prediction.covariance, 2, 0)
    determinant = xx * yy - xy**2
    return math.log(2.0 * math.pi) + 0.5 * np.log(determinant) + 0.5 * mahalanobis_square(prediction, truth)


def inside_half(prediction: Prediction, truth: Float[np.ndarray, "N S 2"]) -> Float[np.ndarray, "S"]:
    """Share of truths inside the ellipse that should hold half of them; .5 is calibrated."""
    square = mahalanobis_square(prediction, truth)
    known = np.isfinite(square)
    return (known & (square <= INSIDE_HALF)).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
