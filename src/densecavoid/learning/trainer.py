"""A training run from start, or from its last checkpoint, to its end: worlds, curriculum, PPO, logs, checkpoints,
exported policies. The algorithm itself is in `ppo`, the worlds in `densecavoid.env`.
"""

from __future__ import annotations

import dataclasses
import os
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gymnasium.vector import VectorEnv
from rich.console import Console

from densecavoid.frames import Observation, require
from densecavoid.learning import ppo
from densecavoid.learning.checkpoint import load_checkpoint, save_checkpoint
from densecavoid.learning.config import TrainConfig
from densecavoid.learning.curriculum import Curriculum
from densecavoid.learning.progress import Display, MetricsLog, Progress
from densecavoid.learning.rollout import Collector, Rollout
from densecavoid.learning.run_folder import RunFolder, config_summary
from densecavoid.learning.worlds import make_training_env, observer_json
from densecavoid.policy.config_json import to_json
from densecavoid.policy.export import describe, export_onnx, load_safetensors, save_safetensors
from densecavoid.policy.network import ActorCritic, NetworkConfig
from densecavoid.sim.spec import Scenario

_RECENT_EPISODES = 200


@dataclass(frozen=True)
class TrainResult:
    """How a run ended."""

    steps: int
    finished: bool
    """False where it was stopped before its budget was spent."""
    stage: str
    level: float
    success_rate: float
    policy: Path
    """The exported policy (ONNX) of the last iteration; `best.onnx` beside it where there is a best one."""


class Trainer:
    """The state of a run: network, optimiser, random generator, worlds, curriculum and counters. One `iterate` collects
    a rollout and learns from it.
    """

    def __init__(self, config: TrainConfig, make_env: Callable[[TrainConfig, Scenario], VectorEnv] = make_training_env):
        self.config = config
        self.device = config.torch_device
        torch.set_num_threads(config.threads or os.cpu_count() or 1)
        torch.manual_seed(config.seed)
        robot = config.sim.robot
        network_config = NetworkConfig.preset(config.network).with_robot(
            robot.max_linear_velocity, robot.max_angular_velocity
        )
        network = ActorCritic(network_config)
        if config.initial_weights is not None:
            loaded, _ = load_safetensors(config.initial_weights)
            if loaded.config != network_config:
                raise ValueError(
                    f"{config.initial_weights} holds the network {loaded.config}, expected {network_config}"
                )
            network = loaded
        self.network = network.to(self.device)
        self.network.set_compute_dtype(config.torch_dtype)
        self.optimiser = ppo.make_optimiser(self.network, config.ppo)
        self.generator = torch.Generator(self.device).manual_seed(config.seed)
        self.curriculum = Curriculum(config.curriculum, config.stages)
        self.env: Any = make_env(config, self.curriculum.scenario())
        self.collector = Collector(
            self.env, config.steps_per_rollout, config.sensors, config.ppo.reward_scale, self.device
        )
        self.collector.reset(config.seed)
        self.steps = 0
        self.iteration = 0
        self.best_score = (-1, -1.0, -1.0)
        self.recent: dict[str, deque[bool]] = {}

    def iterate(self, on_step: Callable[[], None] = lambda: None) -> dict[str, Any]:
        """Collects, learns, moves the curriculum.

        Returns:
            A flat record for the logs.

        Raises:
            TrainingDivergedError: as `ppo.update`.
        """
        started_s = time.perf_counter()
        rollout = self.collector.collect(self.network, self.generator, on_step)
        collected_s = time.perf_counter()
        statistics = ppo.update(
            self.network,
            self.optimiser,
            rollout,
            self.config.ppo,
            self.generator,
            progress=self.steps / self.config.total_steps,
        )
        updated_s = time.perf_counter()
        self.steps += rollout.num_steps
        self.iteration += 1
        for name, success in zip(rollout.episodes.scenario, rollout.episodes.success, strict=True):
            self.recent.setdefault(name, deque(maxlen=_RECENT_EPISODES)).append(success)
        if self.curriculum.update(rollout.episodes.scenario, rollout.episodes.success):
            self.env.scenario = self.curriculum.scenario()
        return {
            "iteration": self.iteration,
            "steps": self.steps,
            "time/steps_per_s": rollout.num_steps / (updated_s - started_s),
            "time/collect_s": collected_s - started_s,
            "time/update_s": updated_s - collected_s,
            "curriculum/stage": self.curriculum.stage,
            "curriculum/stage_index": self.curriculum.stage_index,
            **{f"curriculum/level/{part.scenario}": part.level for part in self.curriculum.mixture()},
            **_episode_means(rollout),
            **{f"success/{name}": float(np.mean(outcomes)) for name, outcomes in self.recent.items()},
            **{f"reward/{name}": value for name, value in rollout.reward_terms.items()},
            **{f"ppo/{name}": value for name, value in dataclasses.asdict(statistics).items()},
        }

    @property
    def score(self) -> tuple[int, float, float]:
        """Grows as training succeeds: stage, then levels, then success rate (-1 until the window is full)."""
        rate = self.curriculum.success_rate if self.curriculum.window_full else -1.0
        return (self.curriculum.stage_index, sum(self.curriculum.levels), rate)

    def state_dict(self) -> dict[str, Any]:
        """Everything that the continuation depends on."""
        assert self.collector.observation is not None
        optimiser = self.optimiser.state_dict()
        return {
            "counters": {"steps": self.steps, "iteration": self.iteration, "best_score": list(self.best_score)},
            "network_config": to_json(self.network.config),
            "network": self.network.state_dict(),
            "optimiser": {
                "state": {str(index): entries for index, entries in optimiser["state"].items()},
                "groups": optimiser["param_groups"],
            },
            "generator": self.generator.get_state(),
            "curriculum": self.curriculum.state_dict(),
            "recent": {name: [int(outcome) for outcome in outcomes] for name, outcomes in self.recent.items()},
            "observation": self.collector.observation._asdict(),
            "env": self.env.state_dict(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continues as if the run had never stopped: the same bits follow, on the same machine and thread count.

        Raises:
            ValueError: if the checkpoint is of another network than this version builds from the same settings.
        """
        built = to_json(self.network.config)
        require(state["network_config"] == built, "the checkpoint's network", state["network_config"], built)
        self.steps = state["counters"]["steps"]
        self.iteration = state["counters"]["iteration"]
        stage, level, rate = state["counters"]["best_score"]
        self.best_score = (stage, level, rate)
        self.network.load_state_dict(_as_tensors(state["network"]))
        self.optimiser.load_state_dict(
            {
                "state": {int(i): _as_tensors(entries) for i, entries in state["optimiser"].get("state", {}).items()},
                "param_groups": state["optimiser"]["groups"],
            }
        )
        self.generator.set_state(torch.from_numpy(state["generator"]))
        self.curriculum.load_state_dict(state["curriculum"])
        self.recent = {
            name: deque((bool(outcome) for outcome in outcomes), maxlen=_RECENT_EPISODES)
            for name, outcomes in state["recent"].items()
        }
        self.env.scenario = self.curriculum.scenario()
        self.env.load_state_dict(state["env"])
        self.collector.observation = Observation(**state["observation"])


def train(
    config: TrainConfig,
    resume: bool = False,
    *,
    make_env: Callable[[TrainConfig, Scenario], VectorEnv] = make_training_env,
    console: Console | None = None,
) -> TrainResult:
    """Runs `config` to its end, to Ctrl-C or SIGTERM (saved, with how to go on), or to an error.

    Args:
        config: settings; `config.run_dir` must hold no run, or with `resume` the run to continue.
        resume: continue from the last checkpoint. Only the budget may differ from the run's settings.
        make_env: builds the worlds; for tests.
        console: where to show progress; for tests.

    Raises:
        FileExistsError: if the folder already holds a run and `resume` is not asked for.
        FileNotFoundError: if there is no run to resume.
        ValueError: if it cannot be resumed with these settings.
        TrainingDivergedError: if losses are no longer finite; the checkpoints stay as they were before.
        OSError: if a file cannot be written (full disk); the last checkpoint stays whole.
    """
    folder = RunFolder(config.run_dir)
    if resume:
        folder.check_resumable(config)
    else:
        folder.create(config)
    trainer = Trainer(config, make_env)
    try:
        if resume and folder.last_checkpoint.exists():
            trainer.load_state_dict(load_checkpoint(folder.last_checkpoint))
        folder.forget_metrics_after(trainer.steps)
        progress = Progress(config.total_steps, steps=trainer.steps)
        log = MetricsLog(folder.metrics_file, folder.tensorboard, trainer.steps if resume else None)
        try:
            with Display(progress, f"{config.name}: {config.run_dir}", console) as display, _stop_on_signals() as stop:
                _run(trainer, folder, log, display, stop)
                finished = trainer.steps >= config.total_steps
                display.message(f"exporting to {folder.path}")
                policy = export_policies(trainer, folder)
        finally:
            log.close()
        if not finished:
            display.message(
                f"stopped at {trainer.steps:,} of {config.total_steps:,} steps; everything is saved. To go on: "
                f"densecavoid train --resume --run-dir {config.run_dir}"
            )
    finally:
        trainer.env.close()
    curriculum = trainer.curriculum
    return TrainResult(trainer.steps, finished, curriculum.stage, curriculum.level, curriculum.success_rate, policy)


def resume(
    run_dir: Path, total_steps: int | None = None, max_minutes: float | None = None, threads: int | None = None
) -> TrainResult:
    """Continues the run in a folder with its own settings; what is given replaces its budget.

    Raises:
        As `train`.
    """
    budget = {"total_steps": total_steps, "max_minutes": max_minutes, "threads": threads}
    given = {name: value for name, value in budget.items() if value is not None}
    return train(replace(RunFolder(run_dir).read_config(), run_dir=run_dir, **given), resume=True)


def export_policies(trainer: Trainer, folder: RunFolder) -> Path:
    """Writes `policy.safetensors` and `policy.onnx` of the present weights, `best.*` of the best checkpoint, if any.

    Returns:
        The path of `policy.onnx`.
    """
    path = _export(trainer.network, trainer, folder.path / "policy", trainer.steps)
    if folder.best_checkpoint.exists():
        best = load_checkpoint(folder.best_checkpoint)
        network = ActorCritic(trainer.network.config)
        network.load_state_dict(_as_tensors(best["network"]))
        _export(network, trainer, folder.path / "best", best["counters"]["steps"])
    return path


def _export(network: ActorCritic, trainer: Trainer, stem: Path, steps: int) -> Path:
    config = trainer.config
    card = describe(
        network,
        config.name,
        config.sensors,
        observer_json(config),
        {"steps": steps, "config": config_summary(config)},
    )
    save_safetensors(stem.with_suffix(".safetensors"), network, card)
    export_onnx(stem.with_suffix(".onnx"), network, card)
    return stem.with_suffix(".onnx")


def _run(trainer: Trainer, folder: RunFolder, log: MetricsLog, display: Display, stop: threading.Event) -> None:
    config, progress = trainer.config, display.progress
    deadline_s = time.monotonic() + 60.0 * config.max_minutes if config.max_minutes > 0 else float("inf")

    def on_step() -> None:
        progress.steps += config.num_envs
        progress.activity = "stopping after this iteration" if stop.is_set() else "collecting"
        if progress.steps == trainer.steps + config.num_envs * config.steps_per_rollout:
            progress.activity = "learning"
        display.tick()

    while trainer.steps < config.total_steps and time.monotonic() < deadline_s and not stop.is_set():
        record = trainer.iterate(on_step)
        log.write(record)
        _show(trainer, record, display)
        if trainer.iteration % config.checkpoint_every == 0:
            _save(trainer, folder)
    _save(trainer, folder)


def _save(trainer: Trainer, folder: RunFolder) -> None:
    improved = trainer.score[2] >= 0 and trainer.score > trainer.best_score
    if improved:
        trainer.best_score = trainer.score
    state = trainer.state_dict()
    save_checkpoint(folder.last_checkpoint, state)
    if improved:
        save_checkpoint(folder.best_checkpoint, state)


def _show(trainer: Trainer, record: dict[str, Any], display: Display) -> None:
    progress = display.progress
    progress.steps = trainer.steps
    speed = record["time/steps_per_s"]
    progress.steps_per_s = speed if progress.steps_per_s == 0 else 0.9 * progress.steps_per_s + 0.1 * speed
    progress.stage, progress.level = trainer.curriculum.stage, trainer.curriculum.level
    progress.success = {name: (float(np.mean(outcomes)), len(outcomes)) for name, outcomes in trainer.recent.items()}
    progress.reward_terms = {
        name.removeprefix("reward/"): value for name, value in record.items() if name.startswith("reward/")
    }
    shown = ("policy_loss", "value_loss", "explained_variance", "kl", "std_linear", "std_angular", "learning_rate")
    progress.learning = {name: record[f"ppo/{name}"] for name in shown}
    display.iteration_done()


def _episode_means(rollout: Rollout) -> dict[str, float]:
    episodes = rollout.episodes
    means = {"episode/count": float(len(episodes.success))}
    if episodes.success:
        means["episode/return"] = float(np.mean(episodes.total_reward))
        means["episode/length"] = float(np.mean(episodes.length))
        means["episode/success"] = float(np.mean(episodes.success))
        means["episode/collision"] = float(np.mean(episodes.collision))
    return means


def _as_tensors(arrays: dict[str, Any]) -> dict[str, torch.Tensor]:
    return {name: torch.from_numpy(np.array(array)) for name, array in arrays.items()}


@contextmanager
def _stop_on_signals() -> Iterator[threading.Event]:
    """An event that the first Ctrl-C or SIGTERM sets; the second Ctrl-C interrupts at once."""
    stop = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield stop
        return

    def on_signal(number: int, frame: object) -> None:
        if stop.is_set() and number == signal.SIGINT:
            raise KeyboardInterrupt
        stop.set()

    before = {number: signal.signal(number, on_signal) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
