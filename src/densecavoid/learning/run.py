"""A training run from start, or from its last checkpoint, to its end: run folder, logs, panel, checkpoints, exported
policies. What it learns and how is in `trainer`.
"""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from densecavoid.learning.checkpoint import as_tensors, load_checkpoint, save_checkpoint
from densecavoid.learning.config import TrainConfig
from densecavoid.learning.peers import PeerLostError, Peers, join_peers
from densecavoid.learning.progress import Display, MetricsLog, Progress
from densecavoid.learning.run_folder import RunFolder, config_summary
from densecavoid.learning.stopping import stop_on_signals
from densecavoid.learning.trainer import MakeEnvs, Trainer
from densecavoid.learning.worlds import make_training_envs, observer_json
from densecavoid.policy.export import describe, export_onnx, save_safetensors
from densecavoid.policy.network import ActorCritic


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


def train(
    config: TrainConfig,
    resume: bool = False,
    *,
    make_envs: MakeEnvs = make_training_envs,
    console: Console | None = None,
) -> TrainResult:
    """Runs `config` to its end, to Ctrl-C or SIGTERM (saved, with how to go on), or to an error. Under torchrun, all
    processes train one policy, and the first writes the run folder.

    Args:
        config: settings; `config.run_dir` must hold no run, or with `resume` the run to continue.
        resume: continue from the last checkpoint. Only the budget may differ from the run's settings.
        make_envs: builds the worlds; for tests.
        console: where to show progress; for tests.

    Raises:
        FileExistsError: if the folder already holds a run and `resume` is not asked for.
        FileNotFoundError: if there is no run to resume.
        ValueError: if it cannot be resumed with these settings.
        TrainingDivergedError: if losses are no longer finite; the checkpoints stay as they were before.
        PeerLostError: if another process of the training has ended; the last checkpoint stays whole.
        OSError: if a file cannot be written (full disk); the last checkpoint stays whole.
    """
    folder = RunFolder(config.run_dir)
    with join_peers(config.torch_device) as peers:
        if peers.is_first:
            if resume:
                folder.check_resumable(config)
            else:
                folder.create(config)
        state = None
        if resume:
            # The first process reads it for all: other machines may not see its disk.
            saved = folder.last_checkpoint.exists() and peers.is_first
            state = peers.gather(load_checkpoint(folder.last_checkpoint) if saved else None)[0]
        trainer = Trainer(config, make_envs, peers, state)
        try:
            return _run_all(trainer, folder, resume, console)
        except PeerLostError as error:
            raise PeerLostError(f"{error}. {_how_to_go_on(folder)}") from error
        finally:
            trainer.close()


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
    """Writes `policy.safetensors` and `policy.onnx` of the present weights, `best.*` of the best checkpoint, if any. A
    teacher has no ONNX form: no robot can run it.

    Returns:
        The path of `policy.onnx`, or of a teacher's `policy.safetensors`.
    """
    path = _export(trainer.policy, trainer, folder.path / "policy", trainer.steps)
    if folder.best_checkpoint.exists():
        best = load_checkpoint(folder.best_checkpoint)
        network = ActorCritic(trainer.network.config)
        network.load_state_dict(as_tensors(best["averaged"] or best["network"]))
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
    if network.config.people == "actor":
        return stem.with_suffix(".safetensors")
    export_onnx(stem.with_suffix(".onnx"), network, card)
    return stem.with_suffix(".onnx")


def _how_to_go_on(folder: RunFolder) -> str:
    if not folder.last_checkpoint.exists():
        return "There is no checkpoint yet"
    return f"The last checkpoint is whole; to go on: densecavoid train --resume --run-dir {folder.path}"


def _run_all(trainer: Trainer, folder: RunFolder, resume: bool, console: Console | None) -> TrainResult:
    config, peers = trainer.config, trainer.peers
    progress = Progress(config.total_steps, steps=trainer.steps)
    policy = folder.path / "policy.onnx"
    if not peers.is_first:
        with stop_on_signals() as stop:
            _iterate(trainer, folder, None, Display(progress, "", Console(quiet=True, force_terminal=False)), stop)
    else:
        folder.forget_metrics_after(trainer.steps)
        log = MetricsLog(folder.metrics_file, folder.tensorboard, trainer.steps if resume else None)
        try:
            with Display(progress, _title(config, peers), console) as display, stop_on_signals() as stop:
                _iterate(trainer, folder, log, display, stop)
                display.message(f"exporting to {folder.path}")
                policy = export_policies(trainer, folder)
        finally:
            log.close()
        if trainer.steps < config.total_steps:
            display.message(
                f"stopped at {trainer.steps:,} of {config.total_steps:,} steps; everything is saved. To go on: "
                f"densecavoid train --resume --run-dir {config.run_dir}"
            )
    curriculum = trainer.curriculum
    finished = trainer.steps >= config.total_steps
    return TrainResult(trainer.steps, finished, trainer.stage, curriculum.level, curriculum.success_rate, policy)


def _title(config: TrainConfig, peers: Peers) -> str:
    return f"{config.name}: {config.run_dir}" + (f" ({peers.count} processes)" if peers.count > 1 else "")


def _iterate(
    trainer: Trainer, folder: RunFolder, log: MetricsLog | None, display: Display, stop: threading.Event
) -> None:
    config, progress, peers = trainer.config, display.progress, trainer.peers
    deadline_s = time.monotonic() + 60.0 * config.max_minutes if config.max_minutes > 0 else float("inf")

    def on_step() -> None:
        progress.steps += config.num_envs * peers.count
        progress.activity = "stopping after this iteration" if stop.is_set() else "collecting"
        if progress.steps == trainer.steps + trainer.steps_per_iteration:
            progress.activity = "learning"
        display.tick()

    while trainer.steps < config.total_steps and not peers.any(stop.is_set() or time.monotonic() >= deadline_s):
        record = trainer.iterate(on_step)
        if log is not None:
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
    if trainer.peers.is_first:
        save_checkpoint(folder.last_checkpoint, state)
        if improved:
            save_checkpoint(folder.best_checkpoint, state)


def _show(trainer: Trainer, record: dict[str, Any], display: Display) -> None:
    progress = display.progress
    progress.steps = trainer.steps
    speed = record["time/steps_per_s"]
    progress.steps_per_s = speed if progress.steps_per_s == 0 else 0.9 * progress.steps_per_s + 0.1 * speed
    progress.stage, progress.level = trainer.stage, trainer.curriculum.level
    progress.success = {name: (float(np.mean(outcomes)), len(outcomes)) for name, outcomes in trainer.recent.items()}
    progress.reward_terms = {
        name.removeprefix("reward/"): value for name, value in record.items() if name.startswith("reward/")
    }
    shown = (
        "policy_loss",
        "imitation_loss",
        "regret",
        "value_loss",
        "explained_variance",
        "kl",
        "std_linear",
        "std_angular",
        "learning_rate",
    )
    keys = {name.split("/")[-1]: name for name in record if name.startswith(("ppo/", "imitation/", "guidance/"))}
    progress.learning = {name: record[keys[name]] for name in shown if name in keys}
    display.iteration_done()
