"""Learned predictors: torch and ONNX agree, the world may be turned, histories may be short, errors are named.

The networks here are untrained with random last layers: what is tested holds for any weights.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from densecavoid.learning.train_predictor import TrainPredictorConfig, first_card  # noqa: E402
from densecavoid.perception.predictor.contract import ROBOT_HORIZONS_S, Histories, histories_of  # noqa: E402
from densecavoid.perception.predictor.export import load_predictor, make_network, save_predictor  # noqa: E402
from densecavoid.perception.predictor.kalman import KalmanPredictor  # noqa: E402
from densecavoid.perception.predictor.learned import LearnedPredictor, every, network_inputs  # noqa: E402

KINDS = ("compact", "robust-tp")


@pytest.fixture(scope="module", params=KINDS)
def saved(request, tmp_path_factory) -> Path:
    """A random predictor's ONNX file; its safetensors file lies beside."""
    torch.manual_seed(0)
    card = first_card(TrainPredictorConfig(kind=request.param))
    network = make_network(card)
    with torch.no_grad():
        for parameter in network.parameters():
            parameter += 0.1 * torch.randn_like(parameter)
    return save_predictor(tmp_path_factory.mktemp("weights"), "random", network, card)


def crowd(seed: int = 0, people: int = 12, worlds: int = 3) -> Histories:
    rng = np.random.default_rng(seed)
    pos = rng.uniform(-4, 4, (people, 1, 2)) + np.cumsum(rng.normal(0.05, 0.05, (people, 32, 2)), axis=1)
    valid = np.arange(32) >= rng.integers(0, 20, people)[:, None]
    return histories_of(pos, 0.1, valid, np.repeat(np.arange(worlds), people // worlds))


def test_torch_and_onnx_agree(saved: Path) -> None:
    network, card = load_predictor(saved.with_suffix(".safetensors"))
    runtime = LearnedPredictor(saved)
    assert runtime.card == card
    inputs, _, _ = network_inputs(card, every(crowd(), card.period_s))
    with torch.no_grad():
        expected = network(*map(torch.from_numpy, inputs)).numpy()
    assert np.abs(expected[..., :2]).max() > 1e-3  # it does say something
    np.testing.assert_allclose(runtime.run(inputs), expected, atol=1e-5)


def test_turning_and_moving_the_world_turns_and_moves_the_prediction(saved: Path) -> None:
    runtime, histories = LearnedPredictor(saved), crowd()
    angle, shift = 2.1, np.array([50.0, -20.0])
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    plain = runtime.predict(histories, ROBOT_HORIZONS_S)
    moved = runtime.predict(histories._replace(pos=histories.pos @ turn.T + shift), ROBOT_HORIZONS_S)
    np.testing.assert_allclose(moved.mean, plain.mean @ turn.T + shift, atol=2e-4)
    full = plain.covariance[..., [0, 1, 1, 2]].reshape(*plain.mean.shape[:2], 2, 2)
    np.testing.assert_allclose(
        moved.covariance[..., [0, 1, 1, 2]].reshape(full.shape), turn @ full @ turn.T, rtol=1e-3, atol=1e-5
    )


def test_covariances_are_proper_and_other_worlds_are_not_seen(saved: Path) -> None:
    runtime, histories = LearnedPredictor(saved), crowd()
    together = runtime.predict(histories, ROBOT_HORIZONS_S)
    xx, xy, yy = np.moveaxis(together.covariance, 2, 0)
    assert (xx > 0).all() and (xx * yy - xy**2 > 0).all()
    rows = slice(4, 8)  # the second world alone
    alone = runtime.predict(
        Histories(histories.pos[rows], histories.valid[rows], histories.group[rows], histories.velocity[rows], 0.1),
        ROBOT_HORIZONS_S,
    )
    np.testing.assert_allclose(alone.mean, together.mean[rows], atol=1e-5)


def test_what_is_not_valid_is_not_looked_at(saved: Path) -> None:
    runtime, histories = LearnedPredictor(saved), crowd()
    nonsense = np.where(histories.valid[..., None], histories.pos, 1e6)
    nothing = np.where(histories.valid[..., None], histories.pos, np.nan)
    first, second = (runtime.predict(histories._replace(pos=pos), ROBOT_HORIZONS_S) for pos in (nonsense, nothing))
    np.testing.assert_array_equal(first.mean, second.mean)
    assert np.isfinite(first.mean).all()


def test_histories_shorter_than_the_network_wants_are_padded(saved: Path) -> None:
    runtime, histories = LearnedPredictor(saved), crowd()
    valid = histories.valid.copy()
    valid[:, :-8] = False
    base = KalmanPredictor(1.0, 0.05).filter(histories._replace(valid=valid))[0][:, -1, 2:]
    full = runtime.predict(histories._replace(valid=valid, velocity=base), ROBOT_HORIZONS_S)
    short = Histories(histories.pos[:, -8:], valid[:, -8:], histories.group, base, 0.1)
    np.testing.assert_allclose(runtime.predict(short, ROBOT_HORIZONS_S).mean, full.mean, atol=1e-6)


def test_a_newborn_track_has_a_prediction_around_its_velocity(saved: Path) -> None:
    pos = np.full((1, 32, 2), np.nan)
    pos[0, -1] = 3.0, 1.0
    histories = histories_of(pos, 0.1, velocity=np.array([[0.8, 0.0]]))
    prediction = LearnedPredictor(saved).predict(histories, ROBOT_HORIZONS_S)
    assert np.isfinite(prediction.mean).all() and np.isfinite(prediction.covariance).all()
    np.testing.assert_allclose(prediction.mean[0, 0], [3.08, 1.0], atol=0.2)


def test_nobody_gives_nothing_and_who_is_not_there_gives_nan(saved: Path) -> None:
    runtime, histories = LearnedPredictor(saved), crowd()
    nobody = Histories(*(array[:0] for array in histories[:4]), period_s=0.1)
    assert runtime.predict(nobody, (0.4, 0.8)).mean.shape == (0, 2, 2)
    valid = histories.valid.copy()
    valid[2, -1] = False
    prediction = runtime.predict(histories._replace(valid=valid), (0.4,))
    assert np.isnan(prediction.mean[2]).all() and np.isnan(prediction.covariance[2]).all()
    assert np.isfinite(np.delete(prediction.mean, 2, axis=0)).all()


def test_between_horizons_predictions_are_between(saved: Path) -> None:
    runtime, histories = LearnedPredictor(saved), crowd()
    prediction = runtime.predict(histories, (0.8, 1.0, 1.2))
    np.testing.assert_allclose(prediction.mean[:, 1], prediction.mean[:, [0, 2]].mean(axis=1), atol=1e-5)
    soon = runtime.predict(histories, (1e-6,))
    np.testing.assert_allclose(soon.mean[:, 0], histories.pos[:, -1], atol=1e-5)


def test_wrong_files_horizons_and_periods_are_refused_by_name(saved: Path, tmp_path: Path) -> None:
    runtime = LearnedPredictor(saved)
    with pytest.raises(ValueError, match=r"horizons_s.*at most 1\.2 s"):
        runtime.predict(crowd(), (1.6,))
    with pytest.raises(ValueError, match=r"period_s is 0\.3"):
        runtime.predict(crowd()._replace(period_s=0.3), (0.4,))
    with pytest.raises(FileNotFoundError, match="no predictor 'oracle'"):
        LearnedPredictor("oracle")
    (tmp_path / "broken.onnx").write_bytes(b"nothing")
    with pytest.raises(ValueError, match=r"broken\.onnx is not an ONNX file"):
        LearnedPredictor(tmp_path / "broken.onnx")
