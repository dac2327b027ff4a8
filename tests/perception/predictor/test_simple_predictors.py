"""Constant velocity and Kalman: against plain matrices, with short histories, nothing, and nonsense."""

from __future__ import annotations

import numpy as np
import pytest

from densecavoid.perception.predictor.constant_velocity import ConstantVelocity
from densecavoid.perception.predictor.contract import Predictor, histories_of
from densecavoid.perception.predictor.kalman import KalmanPredictor
from densecavoid.perception.predictor.registry import make_predictor

BOTH = [ConstantVelocity(), KalmanPredictor()]


def test_kalman_agrees_with_plain_matrices_through_misses_and_at_every_horizon() -> None:
    rng = np.random.default_rng(0)
    pos, dt, q, r = rng.normal(size=(3, 10, 2)).cumsum(axis=1), 0.1, 0.7**2, 0.08**2
    valid = rng.random((3, 10)) < 0.7
    valid[0, :4] = False
    valid[:, -1] = True
    predictor = KalmanPredictor(0.7, 0.08, 1.5)
    prediction = predictor.predict(histories_of(pos, dt, valid), (dt, 4 * dt, 12 * dt))
    eye = np.eye(2)
    step = np.kron(np.array([[1, dt], [0, 1]]), eye)
    push = np.kron(np.array([[dt**2 / 2], [dt]]), eye)
    see = np.kron(np.array([[1.0, 0.0]]), eye)
    for n in range(3):
        state, cov = None, np.diag([r, r, 1.5**2, 1.5**2])
        for h in range(10):
            if state is not None:
                state, cov = step @ state, step @ cov @ step.T + q * push @ push.T
            if not valid[n, h]:
                continue
            if state is None:
                state = np.array([*pos[n, h], 0.0, 0.0])
                continue
            gain = cov @ see.T @ np.linalg.inv(see @ cov @ see.T + r * eye)
            state = state + gain @ (pos[n, h] - see @ state)
            cov = (np.eye(4) - gain @ see) @ cov
        assert state is not None
        for ahead in range(1, 13):
            state, cov = step @ state, step @ cov @ step.T + q * push @ push.T
            if ahead in (1, 4, 12):
                s = (1, 4, 12).index(ahead)
                np.testing.assert_allclose(prediction.mean[n, s], state[:2], rtol=1e-9)
                xx, xy, yy = prediction.covariance[n, s]
                np.testing.assert_allclose([[xx, xy], [xy, yy]], cov[:2, :2], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("predictor", BOTH, ids=lambda predictor: predictor.name)
def test_a_straight_walk_goes_on(predictor: Predictor) -> None:
    walk = np.array([2.0, -1.0]) + np.arange(-31, 1)[:, None] * 0.1 * np.array([0.9, 0.4])
    prediction = predictor.predict(histories_of(walk[None], 0.1), (0.1, 1.2))
    np.testing.assert_allclose(prediction.mean[0], [[2.09, -0.96], [3.08, -0.52]], atol=0.01)
    assert (np.diff(prediction.covariance[0, :, 0]) > 0).all()  # less certain later


@pytest.mark.parametrize("predictor", BOTH, ids=lambda predictor: predictor.name)
def test_one_place_goes_on_at_the_trackers_velocity_or_stands(predictor: Predictor) -> None:
    pos = np.full((2, 32, 2), np.nan)
    pos[:, -1] = 5.0, 1.0
    velocity = np.array([[1.0, -0.5], [np.nan, np.nan]])
    prediction = predictor.predict(histories_of(pos, 0.1, velocity=velocity), (0.4,))
    np.testing.assert_allclose(prediction.mean[:, 0], [[5.4, 0.8], [5.0, 1.0]], atol=1e-9)
    assert (prediction.covariance[:, 0, 0] > 0).all()


@pytest.mark.parametrize("predictor", BOTH, ids=lambda predictor: predictor.name)
def test_nobody_gives_nothing_and_who_is_not_there_gives_nan(predictor: Predictor) -> None:
    nobody = predictor.predict(histories_of(np.zeros((0, 8, 2)), 0.4), (0.4, 0.8))
    assert nobody.mean.shape == (0, 2, 2) and nobody.covariance.shape == (0, 2, 3)
    pos = np.zeros((2, 8, 2))
    pos[0, -1] = np.nan
    prediction = predictor.predict(histories_of(pos, 0.4), (0.4,))
    assert np.isnan(prediction.mean[0]).all() and np.isnan(prediction.covariance[0]).all()
    assert np.isfinite(prediction.mean[1]).all()


def test_wrong_input_is_refused_by_name() -> None:
    pos = np.zeros((3, 8, 2))
    with pytest.raises(ValueError, match=r"group.*adjoin"):
        histories_of(pos, 0.4, group=np.array([0, 1, 0]))
    with pytest.raises(ValueError, match="period_s is 0"):
        histories_of(pos, 0.0)
    with pytest.raises(ValueError, match="horizons_s"):
        ConstantVelocity().predict(histories_of(pos, 0.4), (0.0, 0.4))
    with pytest.raises(ValueError, match=r"KalmanPredictor\.measurement_std"):
        KalmanPredictor(measurement_std=0.0)
    with pytest.raises(ValueError, match=r"unknown predictor 'oracle'.*constant-velocity"):
        make_predictor("oracle")
