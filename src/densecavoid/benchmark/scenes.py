"""Episodes worth looking at: the best and the worst of a benchmark, driven again and kept as what a page can play."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from densecavoid.benchmark.compare import load_episodes
from densecavoid.benchmark.episode import Episode
from densecavoid.benchmark.episode_file import write_json
from densecavoid.benchmark.navigators import make_navigator
from densecavoid.benchmark.rollout import run_episodes
from densecavoid.benchmark.runner import BenchmarkConfig
from densecavoid.scenarios import make_scenario
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.world import Simulator

FRAME_S = 0.2
"""Between the frames of a scene."""


@dataclass(frozen=True)
class Choice:
    """An episode, and why it is shown."""

    navigator: str
    scenario: str
    seed: int
    why: str


def main_navigator(navigators: tuple[str, ...]) -> str:
    """Whose episodes are shown: DenseCAvoid's, or the first one's that is no yardstick."""
    if "densecavoid" in navigators:
        return "densecavoid"
    others = [name for name in navigators if name not in ("oracle", "go-to-goal")]
    return (others or list(navigators))[0]


def choose_scenes(config: BenchmarkConfig) -> Iterator[Choice]:
    """Of each scenario: the main navigator's best and worst episode, one in which it froze, and how the oracle got
    through the world of the worst."""
    cells = load_episodes(config.out / "results.json")
    navigator = main_navigator(config.navigators)
    for scenario in config.scenarios:
        rows = list(cells.get((navigator, scenario), {}).values())
        won = [row for row in rows if row["success"] and row["reference_time_s"]]
        if won:
            best = min(won, key=lambda row: row["duration_s"] / row["reference_time_s"])
            yield Choice(navigator, scenario, best["seed"], "best: quickest beside the oracle's time")
        hit = [row for row in rows if row["at_fault"]]
        frozen = [row for row in rows if row["frozen"]]
        if hit:
            worst, why = min(hit, key=lambda row: row["path_length_m"]), "worst: collided at fault, soonest"
        elif frozen:
            worst, why = max(frozen, key=lambda row: row["duration_s"]), "worst: froze, longest"
        else:
            lost = [row for row in rows if not row["success"]]
            if not lost:
                continue
            worst, why = min(lost, key=lambda row: row["path_length_m"]), "worst: failed soonest"
        yield Choice(navigator, scenario, worst["seed"], why)
        if "oracle" in config.navigators:
            yield Choice("oracle", scenario, worst["seed"], "the same world, driven by the oracle")
        if frozen and hit and scenario.startswith("robot-freezing"):
            yield Choice(navigator, scenario, frozen[0]["seed"], "frozen")


def write_scenes(config: BenchmarkConfig) -> None:
    """Drives the chosen episodes again and writes `scenes.json`."""
    scenes = []
    for choice in choose_scenes(config):
        simulator = Simulator(make_scenario(choice.scenario, config.data), 1, config.sim_config(threads=1))
        navigator = make_navigator(choice.navigator, simulator.config.robot)
        (episode,) = run_episodes(simulator, navigator, [choice.seed], keep_people=True)
        scenes.append({"scenario": choice.scenario, "why": choice.why, **scene_of(episode)})
    write_json(Path(config.out) / "scenes.json", scenes, indent=None)


def scene_of(episode: Episode) -> dict[str, object]:
    """An episode in what a page draws: centimetres as metres with two digits, a frame each `FRAME_S`."""
    last = len(episode.time_s) - 1
    step = max(1, round(FRAME_S / (episode.duration_s / max(last, 1))))
    shown = [*range(0, last, step), last]
    people: list[list[list[float]]] = [[] for _ in shown]
    if episode.people is not None:
        frame_of = {instant: k for k, instant in enumerate(shown)}
        tracks = episode.people
        for instant, (x, y), radius in zip(tracks.instant.tolist(), tracks.pos_w, tracks.radius_m, strict=True):
            if instant in frame_of:
                people[frame_of[instant]].append([round(float(v), 2) for v in (x, y, radius)])
    frozen_from = None if math.isnan(episode.spawn_time_s) else episode.spawn_time_s
    return {
        "navigator": episode.navigator,
        "seed": episode.seed,
        "outcome": episode.outcome,
        "duration_s": round(episode.duration_s, 1),
        "frame_s": FRAME_S,
        "appear_s": frozen_from,
        "goal": episode.goal_w.round(2).tolist(),
        "robot": episode.pose_w[shown].round(2).tolist(),
        "people": people,
        **outlines(episode.floor_plan or FloorPlan()),
    }


def outlines(plan: FloorPlan) -> dict[str, list]:
    """What stands there, seen from above: boxes as corners and whether they are walls, pillars as discs."""
    packed = plan.packed()
    boxes = []
    for x, y, cos, sin, half_length, half_width, z_min, z_max in packed.boxes.astype(np.float64).tolist():
        corners = [
            (x + cos * a * half_length - sin * b * half_width, y + sin * a * half_length + cos * b * half_width)
            for a, b in ((1, 1), (-1, 1), (-1, -1), (1, -1))
        ]
        boxes.append([[[round(px, 2), round(py, 2)] for px, py in corners], z_max > 2.0 and z_min <= 0.0])
    pillars = [[round(v, 2) for v in row[:3]] for row in packed.cylinders.astype(np.float64).tolist()]
    return {"boxes": boxes, "pillars": pillars}
