"""The benchmark: navigators x scenarios x seeds, on one core or many, with the same results. It writes no reports."""

from __future__ import annotations

import json
import multiprocessing
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Literal

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from densecavoid.benchmark.episode_file import plain, versions, write_json
from densecavoid.benchmark.metrics import DEFINITION, EpisodeMetrics, episode_metrics, summarise
from densecavoid.benchmark.navigators import make_navigator, policy_sha256
from densecavoid.benchmark.rollout import run_episodes
from densecavoid.frames import Navigator, require
from densecavoid.scenarios import make_scenario
from densecavoid.sim.config import Attitudes, Motion, Pace
from densecavoid.sim.world import SimConfig, Simulator

TEST_SEEDS_START = 1_000_000_000
"""Seeds of test worlds begin here; training draws its seeds below."""
SEEDS_PER_RUN = 100_000
EPISODES_PER_TASK = 50
"""Fixed, so that how the episodes are shared out does not depend on the number of workers."""

TEST_SCENARIOS = (
    "dense-static",
    "random-sparse-ped",
    "dense-ped",
    "robot-freezing:0.5-1.0",
    "robot-freezing:1.0-1.5",
    "robot-freezing:1.5-2.0",
    "corridor-15",
)


@dataclass(frozen=True)
class BenchmarkConfig:
    """What to measure, on how many worlds, and where to put it."""

    navigators: tuple[str, ...] = ("densecavoid", "go-to-goal")
    """Names, or paths of exported policies (.onnx)."""
    scenarios: tuple[str, ...] = TEST_SCENARIOS
    episodes: int = 500
    """Worlds a cell; every navigator meets the same ones."""
    seed: int = 0
    """Another seed is another set of test worlds."""
    out: Path = Path("benchmark-results")
    """Folder for results.json, episodes.jsonl, tables.md and success.png."""
    workers: int = 1
    """Processes. One works in this process, with all cores for the simulator."""
    data: Path | None = None
    """Folder of the recordings, for the scenarios that need them."""
    people: Attitudes = "scripted"
    pace: Pace = "scenario"
    motion: Motion = "anticipation"
    dynamics: Literal["ideal", "dynamic"] = "ideal"
    sensors: Literal["clean", "real"] = "clean"
    batch_size: int = 16
    """Worlds simulated at once by each process."""

    def __post_init__(self) -> None:
        for name in ("navigators", "scenarios"):
            chosen = getattr(self, name)
            require(len(chosen) > 0, f"BenchmarkConfig.{name}", chosen, "at least one")
            require(len(set(chosen)) == len(chosen), f"BenchmarkConfig.{name}", chosen, "each once")
        require(1 <= self.episodes <= SEEDS_PER_RUN, "BenchmarkConfig.episodes", self.episodes, f"1 to {SEEDS_PER_RUN}")
        require(self.seed >= 0, "BenchmarkConfig.seed", self.seed, "0 or more")
        require(self.workers >= 1, "BenchmarkConfig.workers", self.workers, "at least 1")
        require(self.batch_size >= 1, "BenchmarkConfig.batch_size", self.batch_size, "at least 1")

    def sim_config(self, threads: int) -> SimConfig:
        """The simulator's configuration; `threads` as in SimConfig."""
        return SimConfig(
            people=self.people,
            pace=self.pace,
            motion=self.motion,
            dynamics=self.dynamics,
            sensors=self.sensors,
            threads=threads,
        )

    @property
    def seeds(self) -> range:
        """Of the test worlds, one an episode."""
        start = TEST_SEEDS_START + self.seed * SEEDS_PER_RUN
        return range(start, start + self.episodes)


@dataclass(frozen=True)
class Task:
    """A share of one cell: what a worker needs to know, and can be sent anywhere."""

    navigator: str
    scenario: str
    seeds: tuple[int, ...]
    batch_size: int
    data: Path | None
    sim_config: SimConfig = field(repr=False)

    @property
    def cell(self) -> tuple[str, str]:
        return self.navigator, self.scenario


def run_task(task: Task, on_episode: Callable[[], None] | None = None) -> list[EpisodeMetrics]:
    """Runs a share of a cell from nothing; the same task gives the same figures anywhere."""
    simulator = Simulator(make_scenario(task.scenario, task.data), task.batch_size, task.sim_config)
    navigator = make_navigator(task.navigator, task.sim_config.robot)
    told = None if on_episode is None else lambda episode: on_episode()
    return [episode_metrics(episode) for episode in run_episodes(simulator, navigator, task.seeds, on_episode=told)]


def run_benchmark(config: BenchmarkConfig, console: Console | None = None) -> dict[str, object]:
    """Measures every navigator in every scenario.

    `results.json` and `episodes.jsonl` (the figures of each episode, for paired comparisons) are written after each
    cell, so that a run that is stopped keeps what it has.

    Args:
        config: What to measure.
        console: Where to show the progress; the terminal's standard error unless given.

    Returns:
        What `results.json` holds.

    Raises:
        ValueError: for an unknown navigator or scenario, before anything runs.
        FileNotFoundError: for a policy or recording that is not there, before anything runs.
    """
    navigators = {name: make_navigator(name) for name in config.navigators}
    for scenario in config.scenarios:
        make_scenario(scenario, config.data)
    tasks = _tasks(config)
    shares: dict[tuple[str, str], dict[int, list[EpisodeMetrics]]] = {task.cell: {} for task in tasks}
    expected = {cell: sum(task.cell == cell for task in tasks) for cell in shares}
    finished: dict[tuple[str, str], list[EpisodeMetrics]] = {}
    results: dict[str, object] = {}

    with _progress(console) as progress:
        bar = progress.add_task("starting", total=len(expected) * config.episodes)

        def advance(task: Task, episodes: int) -> None:
            progress.update(bar, advance=episodes, description=f"{task.navigator} in {task.scenario}")

        for task, figures in _execute(tasks, config.workers, advance):
            share = shares[task.cell]
            share[task.seeds[0]] = figures
            if len(share) < expected[task.cell]:
                continue
            finished[task.cell] = [episode for first in sorted(share) for episode in share[first]]
            # In the order asked for, whatever order the cells came in.
            done = {cell: finished[cell] for cell in expected if cell in finished}
            cells = [
                _cell(config, navigators[navigator], navigator, scenario, episodes)
                for (navigator, scenario), episodes in done.items()
            ]
            results = {"definition": DEFINITION, "versions": versions(), "cells": plain(cells)}
            write_json(config.out / "results.json", results)
            _write_episodes(config.out / "episodes.jsonl", done)
    return results


def _tasks(config: BenchmarkConfig) -> list[Task]:
    sim_config = config.sim_config(threads=0 if config.workers == 1 else 1)
    return [
        Task(
            navigator,
            scenario,
            tuple(config.seeds[first : first + EPISODES_PER_TASK]),
            config.batch_size,
            config.data,
            sim_config,
        )
        for scenario in config.scenarios
        for navigator in config.navigators
        for first in range(0, config.episodes, EPISODES_PER_TASK)
    ]


def _execute(
    tasks: list[Task], workers: int, advance: Callable[[Task, int], None]
) -> Iterator[tuple[Task, list[EpisodeMetrics]]]:
    """Each task with its result, as they come; another engine (a cluster) would stand in here."""
    if workers == 1:
        for task in tasks:
            yield task, run_task(task, on_episode=lambda task=task: advance(task, 1))
        return
    # `spawn`, because Numba's and ONNX Runtime's threads do not survive a fork.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context, initializer=_die_on_interrupt) as pool:
        waiting = {pool.submit(run_task, task): task for task in tasks}
        try:
            for future in as_completed(waiting):
                task = waiting.pop(future)
                advance(task, len(task.seeds))
                yield task, future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _die_on_interrupt() -> None:
    """Ctrl-C reaches the workers too; the parent says what happened, they need not."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def _cell(
    config: BenchmarkConfig, navigator: Navigator, name: str, scenario: str, episodes: list[EpisodeMetrics]
) -> dict[str, object]:
    """One cell of results.json."""
    return {
        "navigator": name,
        "scenario": scenario,
        "people": config.people,
        "pace": config.pace,
        "motion": config.motion,
        "dynamics": config.dynamics,
        "sensors": config.sensors,
        "privileged": navigator.privileged,
        "policy_sha256": policy_sha256(navigator),
        "seeds": [config.seeds[0], config.seeds[-1]],
        **summarise(episodes),
    }


def _write_episodes(path: Path, finished: dict[tuple[str, str], list[EpisodeMetrics]]) -> None:
    lines = [
        json.dumps(plain({"navigator": navigator, **asdict(episode), "scenario": scenario}), allow_nan=False)
        for (navigator, scenario), episodes in finished.items()
        for episode in episodes
    ]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _progress(console: Console | None) -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("episodes"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        console=console or Console(stderr=True),
    )
