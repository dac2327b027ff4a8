"""Likelihood and coverage against scipy and against draws from the predicted Gaussians."""

from __future__ import annotations

import numpy as np
from scipy.stats import multivariate_normal

from densecavoid.perception.predictor.calibration import inside_half, mahalanobis_square, negative_log_likelihood
from densecavoid.perception.predictor.contract import Prediction


def some_gaussians(rng: np.random.Generator, count: int) -> tuple[Prediction, np.ndarray]:
    root = rng.normal(size=(count, 2, 2, 2)) + 0.5 * np.eye(2)
    full = root @ np.swapaxes(root, 2, 3) + 0.01 * np.eye(2)
    covariance = np.stack([full[..., 0, 0], full[..., 0, 1], full[..., 1, 1]], axis=2)
    return Prediction(rng.normal(size=(count, 2, 2)), covariance), full


def test_likelihood_is_scipys() -> None:
    rng = np.random.default_rng(0)
    prediction, full = some_gaussians(rng, 20)
    truth = rng.normal(size=(20, 2, 2))
    ours = negative_log_likelihood(prediction, truth)
    for n in range(20):
        for s in range(2):
            theirs = -multivariate_normal(prediction.mean[n, s], full[n, s]).logpdf(truth[n, s])
            np.testing.assert_allclose(ours[n, s], theirs, rtol=1e-9)


def test_half_of_the_draws_are_inside_the_half_ellipse() -> None:
    rng = np.random.default_rng(1)
    prediction, full = some_gaussians(rng, 20_000)
    draws = prediction.mean + np.einsum("nsij,nsj->nsi", np.linalg.cholesky(full), rng.normal(size=(20_000, 2, 2)))
    np.testing.assert_allclose(inside_half(prediction, draws), 0.5, atol=0.015)
    wide = Prediction(prediction.mean, 4.0 * prediction.covariance)
    np.testing.assert_allclose(inside_half(wide, draws), 1 - 0.5**4, atol=0.01)  # by hand: 1 - exp(-4 ln 2)


def test_unknown_truths_count_for_nothing() -> None:
    rng = np.random.default_rng(2)
    prediction, _ = some_gaussians(rng, 4)
    truth = prediction.mean.copy()
    truth[0] = np.nan
    assert np.isnan(mahalanobis_square(prediction, truth)[0]).all()
    np.testing.assert_array_equal(inside_half(prediction, truth), [1.0, 1.0])
