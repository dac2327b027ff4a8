"""Training: the loss by hand, a habit is learned, and a run that was cut off ends as if it had not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from densecavoid.learning import train_predictor as training  # noqa: E402
from densecavoid.learning.train_predictor import TrainPredictorConfig, loss_of, train_predictor  # noqa: E402
from densecavoid.perception.predictor.kalman import KalmanPredictor  # noqa: E402
from densecavoid.perception.predictor.learned import LearnedPredictor  # noqa: E402
from densecavoid.perception.predictor.windows import Windows, cut  # noqa: E402


def circling(seed: int) -> Windows:
    """People who walk in circles of 2 m: what constant velocity never gets right."""
    rng = np.random.default_rng(seed)
    phase, way = rng.uniform(-np.pi, np.pi, 60), rng.choice([-1.0, 1.0], 60)
    angle = phase + way * 0.6 * 0.4 * np.arange(40)[:, None]
    places = 2.0 * np.stack([np.cos(angle), np.sin(angle)], axis=2) + rng.uniform(-30, 30, (60, 2))
    return cut(places, 0.4, 8, tuple(range(1, 13)), complete=True)


@pytest.fixture
def circles(monkeypatch, tmp_path: Path) -> Path:
    """A folder of recordings that nobody reads."""
    monkeypatch.setattr(training, "field_windows", lambda data, without: (circling(0), circling(1)))
    return tmp_path


def config(folder: Path, **changes) -> TrainPredictorConfig:
    return replace(
        TrainPredictorConfig(data=folder, out=folder / "out", task="field", fold="zara1", steps=250, batch=128),
        **changes,
    )


def test_a_habit_is_learned_and_half_of_the_truths_are_in_the_half_ellipse(circles: Path) -> None:
    predictor = LearnedPredictor(train_predictor(config(circles)))
    windows = circling(2)
    horizons = predictor.card.horizons_s
    error, base = (
        np.linalg.norm(each.predict(windows.histories(), horizons).mean - windows.future, axis=2).mean()
        for each in (predictor, KalmanPredictor())
    )
    assert error < 0.5 * base
    assert predictor.card.training["left_out"] == ["zara1"] and predictor.card.training["steps"] == 250
    card = (circles / "out" / "predictor-compact-field-without-zara1.json").read_text()
    assert '"fold"' not in card and '"seed": 0' in card


@pytest.mark.parametrize("kind", ["compact", "robust-tp"])
def test_a_run_that_was_cut_off_ends_as_if_it_had_not(circles: Path, monkeypatch, kind: str) -> None:
    monkeypatch.setattr(training, "_CHECKPOINT_EVERY", 2)
    ends = []
    monkeypatch.setattr(training, "save_predictor", lambda folder, name, network, card: ends.append(network) or folder)
    short = config(circles, kind=kind, steps=5, batch=30)
    train_predictor(replace(short, out=circles / "whole"))

    learn, calls = training._Run.learn, []

    def stops(run, batch):
        calls.append(run.step)
        if len(calls) == 4:
            raise KeyboardInterrupt
        return learn(run, batch)

    monkeypatch.setattr(training._Run, "learn", stops)
    with pytest.raises(KeyboardInterrupt):
        train_predictor(short)
    train_predictor(short)
    assert calls == [0, 1, 2, 3, 2, 3, 4]
    whole, resumed = (network.state_dict() for network in ends)
    for name, tensor in whole.items():
        assert torch.equal(tensor, resumed[name]), name
    with pytest.raises(ValueError, match="checkpoint"):
        train_predictor(replace(short, seed=1))


def test_loss_by_hand() -> None:
    horizons = torch.tensor([0.4, 0.8])
    gaussians = torch.tensor([[[0.0, 0.0, 0.5, 2.0, 0.0], [1.0, 1.0, 1.0, 1.0, 0.0]]])
    truth = torch.tensor([[[0.3, 0.4], [float("nan"), 0.0]]])
    # One truth known: distance .5 m with weight 1 / (.8 / 12 + .4); the spread's part with log(.5) + log(2) = 0.
    expected = 0.5 / (0.8 / 12 + 0.4) + 0.05 * 0.5 * (0.6**2 + 0.2**2)
    assert float(loss_of(gaussians, truth, torch.tensor([3.0]), horizons)) == pytest.approx(expected, rel=1e-4)


def test_the_mean_does_not_follow_the_likelihood() -> None:
    mean = torch.zeros(1, 1, 2, requires_grad=True)
    spread = torch.tensor([[[0.1, 0.1, 0.0]]], requires_grad=True)
    loss_of(
        torch.cat([mean, spread], dim=2), torch.tensor([[[1.0, 0.0]]]), torch.ones(1), torch.tensor([0.4])
    ).backward()
    assert mean.grad is not None and spread.grad is not None
    np.testing.assert_allclose(mean.grad[0, 0], [-1.0 / (0.4 / 12 + 0.4), 0.0], atol=1e-4)
    assert spread.grad[0, 0, 0] < 0  # wider would be likelier


def test_wrong_settings_are_refused_by_name() -> None:
    with pytest.raises(ValueError, match="fold is 'eth', expected 'all' for the task 'robot'"):
        TrainPredictorConfig(fold="eth")
    with pytest.raises(ValueError, match=r"TrainPredictorConfig\.steps is 0"):
        TrainPredictorConfig(steps=0)
