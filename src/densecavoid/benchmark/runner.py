"""The benchmark: navigators x scenarios x solvable worlds, on one core or many, with the same results. It writes no
reports."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from densecavoid.benchmark.engines import Engine, open_engine
from densecavoid.benchmark.episode import Episode
from densecavoid.benchmark.episode_file import plain, versions, write_json
from densecavoid.benchmark.metrics import DEFINITION, EpisodeMetrics, episode_metrics, summarise
from densecavoid.benchmark.navigators import make_navigator, policy_sha256
from densecavoid.benchmark.rollout import run_episodes
from densecavoid.benchmark.solvable import Admission, Seeds, admit
from densecavoid.benchmark.statistics import wilson_interval
from densecavoid.foresight.planner import Judgement, judge_worlds
from densecavoid.frames import Navigator, require
from densecavoid.scenarios import make_scenario
from densecavoid.sim._jit import available_threads, source_digest
from densecavoid.sim.config import Attitudes, Motion, Pace
from densecavoid.sim.spec import Scenario
from densecavoid.sim.world import SimConfig, Simulator

TEST_SEEDS_START = 1_000_000_000
"""Seeds of test worlds begin here; training draws its seeds below."""
SEEDS_PER_RUN = 100_000
EPISODES_PER_TASK = 50
"""Fixed, so that how the episodes are shared out does not depend on the number of workers."""
PATH_STEP_S = 0.5
"""Between the places of a path that is kept for pictures."""

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

    navigators: tuple[str, ...] = ("densecavoid", "go-to-goal", "oracle")
    """Names, or paths of exported policies (.onnx)."""
    scenarios: tuple[str, ...] = TEST_SCENARIOS
    episodes: int = 500
    """Worlds a cell; every navigator meets the same ones."""
    seed: int = 0
    """Another seed is another set of test worlds."""
    out: Path = Path("benchmark-results")
    """Folder for results.json, episodes.jsonl, tables.md, index.html; what is in it already is not done again."""
    workers: int = 0
    """Processes; 0 takes all cores. One works in this process, with all cores for the simulator."""
    ray: str | None = None
    """Address of a Ray cluster that does the work instead: auto, local or HOST:PORT."""
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
        most = SEEDS_PER_RUN // 10  # worlds that cannot be solved take seeds too
        require(1 <= self.episodes <= most, "BenchmarkConfig.episodes", self.episodes, f"1 to {most}")
        require(self.seed >= 0, "BenchmarkConfig.seed", self.seed, "0 or more")
        require(self.workers >= 0, "BenchmarkConfig.workers", self.workers, "0 (all cores) or more")
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
    def first_seed(self) -> int:
        """Of the test worlds that are tried."""
        return TEST_SEEDS_START + self.seed * SEEDS_PER_RUN


@dataclass(frozen=True)
class JudgeTask:
    """Worlds to be judged, before anybody drives in them."""

    scenario: Scenario
    seeds: Seeds
    sim_config: SimConfig = field(repr=False)


@dataclass(frozen=True)
class Task:
    """A share of one cell: what a worker needs to know, and can be sent anywhere."""

    navigator: str
    scenario: str
    seeds: Seeds
    batch_size: int
    data: Path | None
    sim_config: SimConfig = field(repr=False)
    judgements: tuple[tuple[float | None, float | None], ...] = field(repr=False)
    """Of each world: the planner's time (s), and the density (people per m2)."""

    @property
    def cell(self) -> tuple[str, str]:
        return self.navigator, self.scenario


@dataclass(frozen=True)
class Share:
    """What came of a task."""

    episodes: list[EpisodeMetrics]
    paths: list[list[list[float]]]
    """Of each episode: places (x, y) in metres, .5 s apart, the last one, and the goal."""


def judge_task(task: JudgeTask) -> list[Judgement]:
    """Judges a few worlds; the same anywhere."""
    return judge_worlds(task.scenario, task.seeds, task.sim_config)


def run_task(task: Task) -> Share:
    """Runs a share of a cell from nothing; the same task gives the same figures anywhere."""
    simulator = Simulator(make_scenario(task.scenario, task.data), task.batch_size, task.sim_config)
    navigator = make_navigator(task.navigator, task.sim_config.robot)
    episodes = run_episodes(simulator, navigator, task.seeds)
    figures = [
        episode_metrics(episode, None, *judgement) for episode, judgement in zip(episodes, task.judgements, strict=True)
    ]
    return _as_kept({"episodes": [asdict(figure) for figure in figures], "paths": [_path(e) for e in episodes]})


def run_benchmark(config: BenchmarkConfig, console: Console | None = None) -> dict[str, object]:
    """Measures every navigator in every scenario, on worlds that can be solved.

    Each share of a cell is kept in `config.out` as soon as it is done, so that a run that was stopped goes on where it
    was. `results.json`, `episodes.jsonl` (the figures of each episode, for paired comparisons) and `paths.json` are
    written after each cell.

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
    scenarios = {name: make_scenario(name, config.data) for name in config.scenarios}
    results: dict[str, object] = {}
    with open_engine(config.workers or available_threads(), config.ray) as engine, _progress(console) as progress:
        bar = progress.add_task("starting", total=None, unit="worlds")
        admissions = {}
        for name, scenario in scenarios.items():
            progress.update(bar, description=f"can {name} be solved?", total=config.episodes, completed=0)

            def judged(worlds: int) -> None:
                progress.advance(bar, worlds)

            admissions[name] = _admit(engine, scenario, config, judged)
        worlds = [_worlds(name, admission) for name, admission in admissions.items()]
        tasks = _tasks(config, navigators, admissions, engine.threads)
        expected = {cell: sum(task.cell == cell for task in tasks) for cell in {task.cell: None for task in tasks}}
        shares: dict[tuple[str, str], dict[int, Share]] = {cell: {} for cell in expected}
        finished: dict[tuple[str, str], list[Share]] = {}
        total = sum(len(task.seeds) for task in tasks)
        progress.update(bar, description="driving", total=total, completed=0, unit="episodes")
        for task, share in _resumed(engine, tasks, config.out / "shares", navigators):
            progress.update(bar, advance=len(task.seeds), description=f"{task.navigator} in {task.scenario}")
            shares[task.cell][task.seeds[0]] = share
            if len(shares[task.cell]) < expected[task.cell]:
                continue
            finished[task.cell] = [shares[task.cell][first] for first in sorted(shares[task.cell])]
            # In the order asked for, whatever order the cells came in.
            done = {cell: finished[cell] for cell in expected if cell in finished}
            cells = [
                _cell(config, navigators[navigator], navigator, admissions[scenario], scenario, episodes_of(parts))
                for (navigator, scenario), parts in done.items()
            ]
            results = {
                "definition": DEFINITION,
                "versions": versions(),
                "worlds": plain(worlds),
                "cells": plain(cells),
            }
            write_json(config.out / "results.json", results)
            _write_episodes(config.out, done)
    require(bool(results), "worlds that can be solved", 0, "at least one in one of the scenarios")
    return results


def episodes_of(shares: Sequence[Share]) -> list[EpisodeMetrics]:
    """All episodes of a cell."""
    return [episode for share in shares for episode in share.episodes]


def _admit(engine: Engine, scenario: Scenario, config: BenchmarkConfig, on_worlds) -> Admission:
    def judge_many(scenario: Scenario, shares: Sequence[Seeds], sim_config: SimConfig):
        tasks = [JudgeTask(scenario, seeds, sim_config) for seeds in shares]
        return ((task.seeds, judgements) for task, judgements in engine.map(judge_task, tasks))

    sim_config = config.sim_config(engine.threads)
    return admit(scenario, sim_config, config.first_seed, config.episodes, judge_many, on_worlds)


def _tasks(
    config: BenchmarkConfig, navigators: dict[str, Navigator], admissions: dict[str, Admission], threads: int
) -> list[Task]:
    tasks = []
    for scenario, admission in admissions.items():
        judgements = {
            seed: (None if judgement.plan is None else judgement.plan.time_s, judgement.density_per_m2)
            for seed, judgement in admission.judgements.items()
        }
        for navigator in navigators:
            for first in range(0, len(admission.seeds), EPISODES_PER_TASK):
                seeds = admission.seeds[first : first + EPISODES_PER_TASK]
                known = tuple(judgements[seed] for seed in seeds)
                size, sim_config = config.batch_size, config.sim_config(threads)
                tasks.append(Task(navigator, scenario, seeds, size, config.data, sim_config, known))
    return tasks


def _resumed(
    engine: Engine, tasks: Sequence[Task], folder: Path, navigators: dict[str, Navigator]
) -> Iterable[tuple[Task, Share]]:
    """Each task with its share: from the folder what an earlier run of the same versions left there, then the rest."""
    source = source_digest(".")

    def file_of(task: Task) -> Path:
        sim_config = repr(task.sim_config).rsplit("threads=", 1)[0]  # which changes no result, nor does the batch size
        policy = policy_sha256(navigators[task.navigator])
        what = (DEFINITION, source, task.navigator, policy, task.scenario, task.seeds, task.judgements, sim_config)
        return folder / f"{hashlib.sha256(repr(what).encode()).hexdigest()[:24]}.json"

    missing = []
    for task in tasks:
        try:
            yield task, _as_kept(json.loads(file_of(task).read_text(encoding="utf-8")))
        except (OSError, ValueError, KeyError, TypeError):
            missing.append(task)
    for task, share in engine.map(run_task, missing):
        write_json(file_of(task), {"episodes": [asdict(e) for e in share.episodes], "paths": share.paths}, indent=None)
        yield task, share


def _as_kept(share: dict) -> Share:
    """The share as it is read back: rounded as files are, so that a resumed run gives the same figures."""
    kept = json.loads(json.dumps(plain(share), allow_nan=False))
    return Share([EpisodeMetrics(**row) for row in kept["episodes"]], kept["paths"])


def _path(episode: Episode) -> list[list[float]]:
    times = np.append(np.arange(0.0, episode.duration_s, PATH_STEP_S), episode.duration_s)
    places = [np.interp(times, episode.time_s, episode.pose_w[:, axis]) for axis in (0, 1)]
    return np.concatenate([np.stack(places, axis=1), episode.goal_w[None]]).round(2).tolist()


def _worlds(scenario: str, admission: Admission) -> dict[str, object]:
    """What is said of a scenario's worlds in results.json."""
    times = [judgement.plan.time_s for judgement in admission.judgements.values() if judgement.plan is not None]
    return {
        "scenario": scenario,
        "tried": admission.tried,
        "solvable": admission.solved,
        "share": admission.share,
        "share_ci95": list(wilson_interval(admission.solved, admission.tried)),
        "filtered": admission.filtered,
        "admitted": len(admission.seeds),
        "reference_time_s": float(np.mean(times)) if times else None,
    }


def _cell(
    config: BenchmarkConfig,
    navigator: Navigator,
    name: str,
    admission: Admission,
    scenario: str,
    episodes: list[EpisodeMetrics],
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
        "seeds": [admission.seeds[0], admission.seeds[-1]],
        **summarise(episodes),
    }


def _write_episodes(out: Path, finished: dict[tuple[str, str], list[Share]]) -> None:
    lines = [
        json.dumps(plain({"navigator": navigator, **asdict(episode), "scenario": scenario}), allow_nan=False)
        for (navigator, scenario), shares in finished.items()
        for episode in episodes_of(shares)
    ]
    partial = out / "episodes.jsonl.part"
    partial.write_text("\n".join(lines) + "\n", encoding="utf-8")
    os.replace(partial, out / "episodes.jsonl")
    # Enough for pictures: the first share of each cell.
    paths = [
        {"navigator": navigator, "scenario": scenario, "paths": shares[0].paths}
        for (navigator, scenario), shares in finished.items()
    ]
    write_json(out / "paths.json", paths, indent=None)


def _progress(console: Console | None) -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[unit]}"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        console=console or Console(stderr=True),
    )
