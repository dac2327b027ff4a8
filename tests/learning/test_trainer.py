"""Promises of a training run: it resumes to the same bits, stops cleanly, and leaves a folder that explains itself."""

from __future__ import annotations

import dataclasses
import io
import json
import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from fake_env import PointEnv  # noqa: E402
from rich.console import Console  # noqa: E402

from densecavoid.learning import run as run_module  # noqa: E402
from densecavoid.learning.checkpoint import load_checkpoint, save_checkpoint  # noqa: E402
from densecavoid.learning.config import TrainConfig  # noqa: E402
from densecavoid.learning.curriculum import CurriculumConfig  # noqa: E402
from densecavoid.learning.ppo import PPOConfig, TrainingDivergedError  # noqa: E402
from densecavoid.learning.run import train  # noqa: E402
from densecavoid.learning.run_folder import RunFolder  # noqa: E402
from densecavoid.learning.trainer import Trainer  # noqa: E402
from densecavoid.policy.export import load_safetensors  # noqa: E402
from densecavoid.policy.network import PRESETS, NetworkConfig  # noqa: E402
from densecavoid.policy.runtime import OnnxPolicy  # noqa: E402
from densecavoid.sim.spec import Scenario  # noqa: E402

STEPS_AN_ITERATION = 8 * 16


@pytest.fixture(autouse=True)
def _small_and_fast(
    monkeypatch: pytest.MonkeyPatch, tiny_network: NetworkConfig, request: pytest.FixtureRequest
) -> None:
    """A tiny network; and the ONNX exporter, which takes seconds, only where it is asked for."""
    monkeypatch.setitem(PRESETS, "compact", tiny_network)
    if "real_export" not in request.fixturenames:
        monkeypatch.setattr(run_module, "export_onnx", lambda path, network, card: None)


@pytest.fixture
def real_export() -> None:
    """Asks for the ONNX exporter."""


def make_envs(config: TrainConfig, scenario: Scenario, first_world: int) -> list[PointEnv]:
    return [PointEnv(config.num_envs, scenario=scenario)]


@pytest.fixture
def config(tmp_path: Path) -> TrainConfig:
    return TrainConfig(
        run_dir=tmp_path / "run",
        num_envs=8,
        steps_per_rollout=16,
        total_steps=4 * STEPS_AN_ITERATION,
        threads=1,
        precision="float32",
        checkpoint_every=1,
        ppo=PPOConfig(minibatch_size=64, schedule="linear", learning_rate=3e-3),
        curriculum=CurriculumConfig(window=3, threshold=1.0, level_step=0.5),
    )


def run(config: TrainConfig, resume: bool = False, make: Callable[..., Any] = make_envs) -> tuple[Any, str]:
    screen = io.StringIO()
    result = train(config, resume, make_envs=make, console=Console(file=screen))
    return result, screen.getvalue()


def assert_same(one: Any, other: Any, key: str = "") -> None:
    if isinstance(one, dict):
        assert one.keys() == other.keys()
        for name in one:
            assert_same(one[name], other[name], f"{key}/{name}")
    elif isinstance(one, np.ndarray):
        assert one.dtype == other.dtype and one.shape == other.shape and one.tobytes() == other.tobytes(), key
    else:
        assert one == other, key


@pytest.mark.parametrize("averaging", [0.0, 0.5])
def test_a_run_stopped_and_resumed_gives_the_same_bits_as_one_that_never_stopped(
    config: TrainConfig, averaging: float
) -> None:
    config = dataclasses.replace(config, averaging=averaging)
    whole = dataclasses.replace(config, run_dir=config.run_dir / "whole")
    run(whole)
    parts = dataclasses.replace(config, run_dir=config.run_dir / "parts")
    # The linear schedule depends on total_steps: the run is cut by hand instead of by a smaller budget.
    folder = RunFolder(parts.run_dir)
    folder.create(parts)
    first = Trainer(parts, make_envs)
    for _ in range(2):
        first.iterate()
    save_checkpoint(folder.last_checkpoint, first.state_dict())
    result, _ = run(parts, resume=True)
    assert result.finished
    one, other = (load_checkpoint(RunFolder(each.run_dir).last_checkpoint) for each in (whole, parts))
    del one["counters"]["best_score"], other["counters"]["best_score"]
    assert one["counters"]["iteration"] == 4
    assert_same(one, other)


def test_the_policy_given_out_is_the_mean_over_updates(config: TrainConfig) -> None:
    """Each counts as much as all before it, with averaging .5; and what is learned does not depend on it."""
    plain, averaged = (Trainer(dataclasses.replace(config, averaging=share), make_envs) for share in (0.0, 0.5))
    weights = []
    for _ in range(3):
        plain.iterate()
        averaged.iterate()
        weights.append(plain.network.actor_output.weight.detach().clone())
    assert torch.equal(averaged.network.actor_output.weight, weights[-1])
    expected = 0.25 * weights[0] + 0.25 * weights[1] + 0.5 * weights[2]
    torch.testing.assert_close(averaged.policy.actor_output.weight, expected)
    assert not torch.equal(averaged.policy.actor_output.weight, weights[-1])
    assert plain.policy is plain.network


def test_the_comparison_of_bits_can_fail(config: TrainConfig) -> None:
    """Another seed, and a generator that is not restored, are both seen by the comparison."""
    states = []
    for seed in (0, 0, 1):
        trainer = Trainer(dataclasses.replace(config, seed=seed), make_envs)
        trainer.iterate()
        states.append(trainer.state_dict())
    weights = [state["network"]["actor_output.weight"] for state in states]
    assert torch.equal(weights[0], weights[1])
    assert not torch.equal(weights[0], weights[2])


def test_the_folder_explains_itself(config: TrainConfig, real_export: None) -> None:
    result, screen = run(config)
    folder = RunFolder(config.run_dir)
    assert folder.read_config() == config
    provenance = json.loads((config.run_dir / "provenance.json").read_text())
    assert provenance["packages"]["torch"] == torch.__version__.split("+")[0] or provenance["packages"]["torch"]
    lines = [json.loads(line) for line in folder.metrics_file.read_text().splitlines()]
    assert [line["steps"] for line in lines] == [STEPS_AN_ITERATION * k for k in (1, 2, 3, 4)]
    assert {
        "ppo/kl",
        "reward/turn",
        "success/random-goal",
        "time/steps_per_s",
        "curriculum/level/random-goal",
    } <= lines[-1].keys()
    assert list(folder.tensorboard.glob("events.out.tfevents.*"))
    assert "512/512 steps" in screen
    network, card = load_safetensors(config.run_dir / "policy.safetensors")
    assert card.training["steps"] == 512
    policy = OnnxPolicy(result.policy)
    assert policy.card == card
    assert str(config.run_dir) not in json.dumps(dataclasses.asdict(card))
    assert (config.run_dir / "best.onnx").exists()
    assert network.config.name == "tiny"


def test_the_curriculum_reaches_the_worlds(config: TrainConfig) -> None:
    trainer = Trainer(config, make_envs)
    before = trainer.envs[0].scenario
    while not trainer.recent or trainer.curriculum.level == 0.0:
        trainer.iterate()
    assert trainer.envs[0].scenario != before
    assert trainer.envs[0].scenario == trainer.curriculum.scenario()


def test_a_signal_saves_and_says_how_to_resume(config: TrainConfig) -> None:
    class Interrupted(PointEnv):
        def step(self, actions: np.ndarray) -> Any:
            if len(self.received) == 20:
                os.kill(os.getpid(), signal.SIGTERM)
            return super().step(actions)

    handler = signal.getsignal(signal.SIGTERM)
    result, screen = run(config, make=lambda config, scenario, first: [Interrupted(config.num_envs, scenario=scenario)])
    assert signal.getsignal(signal.SIGTERM) is handler
    assert not result.finished and result.steps == 2 * STEPS_AN_ITERATION
    assert f"densecavoid train --resume --run-dir {config.run_dir}" in screen
    assert load_checkpoint(RunFolder(config.run_dir).last_checkpoint)["counters"]["steps"] == result.steps
    result, _ = run(config, resume=True)
    assert result.finished and result.steps == config.total_steps
    lines = RunFolder(config.run_dir).metrics_file.read_text().splitlines()
    assert [json.loads(line)["iteration"] for line in lines] == [1, 2, 3, 4]


def test_a_crash_between_checkpoints_leaves_no_double_lines_in_the_log(config: TrainConfig) -> None:
    class Crashing(PointEnv):
        def step(self, actions: np.ndarray) -> Any:
            if len(self.received) == 3 * 16 + 1:
                raise RuntimeError("the power went")
            return super().step(actions)

    config = dataclasses.replace(config, checkpoint_every=2)
    with pytest.raises(RuntimeError, match="the power went"):
        run(config, make=lambda config, scenario, first: [Crashing(config.num_envs, scenario=scenario)])
    result, _ = run(config, resume=True)
    assert result.finished
    lines = RunFolder(config.run_dir).metrics_file.read_text().splitlines()
    assert [json.loads(line)["iteration"] for line in lines] == [1, 2, 3, 4]


def test_a_loss_that_is_not_finite_stops_with_the_last_checkpoint_kept(config: TrainConfig) -> None:
    class Poisoned(PointEnv):
        def step(self, actions: np.ndarray) -> Any:
            observation, reward, *rest = super().step(actions)
            return observation, reward * (np.nan if len(self.received) > 40 else 1.0), *rest

    with pytest.raises(TrainingDivergedError, match="loss is nan"):
        run(config, make=lambda config, scenario, first: [Poisoned(config.num_envs, scenario=scenario)])
    state = load_checkpoint(RunFolder(config.run_dir).last_checkpoint)
    assert state["counters"]["iteration"] == 2
    assert all(np.isfinite(array).all() for array in state["network"].values())


def test_a_folder_that_holds_a_run_is_not_overwritten_and_settings_do_not_change_on_resume(config: TrainConfig) -> None:
    run(config)
    with pytest.raises(FileExistsError, match="already holds a run"):
        run(config)
    with pytest.raises(ValueError, match="seed was 0 and is 3"):
        run(dataclasses.replace(config, seed=3), resume=True)
    longer, _ = run(dataclasses.replace(config, total_steps=5 * STEPS_AN_ITERATION), resume=True)
    assert longer.steps == 5 * STEPS_AN_ITERATION
    with pytest.raises(FileNotFoundError, match="holds no run"):
        run(dataclasses.replace(config, run_dir=config.run_dir / "nowhere"), resume=True)


def test_a_run_can_start_from_the_weights_of_another(config: TrainConfig) -> None:
    run(config)
    weights = config.run_dir / "policy.safetensors"
    second = Trainer(dataclasses.replace(config, run_dir=config.run_dir / "second", initial_weights=weights), make_envs)
    first, _ = load_safetensors(weights)
    assert all(torch.equal(tensor, first.state_dict()[name]) for name, tensor in second.network.state_dict().items())


def test_the_time_limit_ends_the_run(config: TrainConfig, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = iter(range(0, 10**6, 30))
    monkeypatch.setattr(run_module.time, "monotonic", lambda: float(next(clock)))
    result, _ = run(dataclasses.replace(config, max_minutes=1.0))
    assert not result.finished and 0 < result.steps < config.total_steps


def test_settings_that_make_no_sense_are_named() -> None:
    with pytest.raises(ValueError, match=r"TrainConfig.num_envs is 0, expected positive"):
        TrainConfig(num_envs=0)
    with pytest.raises(ValueError, match=r"PPOConfig.discount is 1\.5"):
        PPOConfig(discount=1.5)


def test_a_resumed_run_gives_the_same_bits_in_the_real_worlds(
    config: TrainConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.undo()
    config = dataclasses.replace(
        config,
        num_envs=4,
        steps_per_rollout=12,
        stage="random-pedestrians",
        sim=dataclasses.replace(config.sim, threads=1),
    )
    whole = Trainer(config)
    whole.iterate()
    save_checkpoint(config.run_dir.parent / "half.safetensors", whole.state_dict())
    whole.iterate()
    resumed = Trainer(dataclasses.replace(config, seed=config.seed))
    resumed.load_state_dict(load_checkpoint(config.run_dir.parent / "half.safetensors"))
    resumed.iterate()
    states = []
    for trainer in (whole, resumed):
        path = config.run_dir.parent / "end.safetensors"
        save_checkpoint(path, trainer.state_dict())
        states.append(load_checkpoint(path))
    assert_same(*states)


def test_a_checkpoint_of_another_network_is_refused(config: TrainConfig) -> None:
    trainer = Trainer(config, make_envs)
    state = trainer.state_dict()
    state["network_config"] = state["network_config"].replace('"name": "', '"name": "other ')
    with pytest.raises(ValueError, match=r"the checkpoint's network is .*other "):
        trainer.load_state_dict(state)
