"""How well the tracker follows simulated crowds past whom a robot drives, and what that costs.

What all sensors see is recorded once and can be tracked again with other settings.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from densecavoid.frames import Navigator, SensorFrame, Truth, require
from densecavoid.perception.detections import Detections
from densecavoid.perception.evaluation.legs import rays_on_legs
from densecavoid.perception.legs import LegDetector
from densecavoid.perception.metrics import MATCH_M, TrackingFrame, TrackingScores, pooled_scores, score_tracks
from densecavoid.perception.sources import PeopleSource
from densecavoid.perception.tracker import Sighting, Tracker
from densecavoid.perception.tracker_settings import TrackerSettings
from densecavoid.perception.visibility import depth_view, lidar_view
from densecavoid.scenarios import make_scenario
from densecavoid.sim.spec import Scenario
from densecavoid.sim.world import SimConfig, Simulator

TESTS = ("dense-ped", "random-sparse-ped", "corridor-15")
WITHIN_M = 5.0
"""People farther from the robot do not count, tracked or not."""
IN_VIEW_S = 1.0
"""For the second count: who has been hidden for longer does not count."""
_LEAST_PIXELS = 30  # of 60 x 80 that show somebody who is visible: a fifth of a person at 5 m
_LEAST_RAYS = 3


@dataclass(frozen=True)
class TrackingRun:
    """Settings of a recording."""

    worlds: int = 8
    steps: int = 200
    """Control steps of each world; who arrives or collides begins anew in another."""
    seed: int = 20_000
    legs: bool = True
    """Whether the lidar takes part."""
    sim: SimConfig = field(default_factory=lambda: SimConfig(sensors="real"))

    def __post_init__(self) -> None:
        for name in ("worlds", "steps"):
            require(getattr(self, name) >= 1, f"TrackingRun.{name}", getattr(self, name), "at least 1")


class Moment(NamedTuple):
    """What a batch of robots had before them at one instant, in their odometry frames."""

    episode: Int[np.ndarray, "B"]
    """No two episodes of a recording have the same number."""
    pose: Float[np.ndarray, "B 3"]
    depth_m: Float32[np.ndarray, "B height width"]
    scan_m: Float32[np.ndarray, "B rays"]
    camera: Detections
    legs: Detections | None
    person: Int[np.ndarray, "B P"]
    """-1: nobody."""
    person_pos: Float[np.ndarray, "B P 2"]
    hidden_s: Float[np.ndarray, "B P"]
    """Since somebody was last visible; inf: never yet."""


def record(scenario: str | Scenario, navigator: Navigator, source: PeopleSource, run: TrackingRun) -> list[Moment]:
    """Drives robots through a scenario and keeps what they see.

    Args:
        source: of the camera's detections, for `run.worlds` worlds.
    """
    made = make_scenario(scenario) if isinstance(scenario, str) else scenario
    simulator = Simulator(made, run.worlds, run.sim)
    legs = LegDetector(run.sim.lidar, run.worlds, run.sim.threads) if run.legs else None
    every = np.ones(run.worlds, np.bool_)
    episode, fresh = np.arange(run.worlds), every.copy()
    last_shown: list[dict[int, int]] = [{} for _ in range(run.worlds)]
    simulator.reset(run.seed + episode)
    moments = []
    for step in range(run.steps):
        for b in np.flatnonzero(fresh):
            last_shown[b] = {}
        navigator.reset(fresh)
        source.reset(fresh)
        frame = simulator.sense()
        assert frame.truth is not None
        people = frame.truth.people
        hidden = np.full(people.active.shape, np.inf)
        for b, shown in enumerate(_visible(simulator, frame, run)):
            for p in np.flatnonzero(people.active[b]):
                who = int(people.id[b, p])
                if shown[p]:
                    last_shown[b][who] = step
                if who in last_shown[b]:
                    hidden[b, p] = (step - last_shown[b][who]) * run.sim.control_dt_s
        moments.append(
            Moment(
                episode.copy(),
                frame.odom_pose.copy(),
                frame.depth_m.copy(),
                frame.scan_m.copy(),
                _copy(source.find(frame, every)),
                None if legs is None else _copy(legs.detect(frame.scan_m, frame.odom_pose)),
                np.where(people.active, people.id, -1),
                to_odometry(frame.truth, frame.odom_pose),
                hidden,
            )
        )
        simulator.step(navigator.act(frame))
        fresh = simulator.done.copy()
        episode[fresh] += run.worlds
        if fresh.any():
            simulator.reset(run.seed + episode, fresh)
    return moments


def to_odometry(truth: Truth, odom_pose: Float[np.ndarray, "B 3"]) -> Float[np.ndarray, "B P 2"]:
    """Where everybody is, as a robot sees it that believes to be at `odom_pose`."""
    off = truth.people.pos_w - truth.robot_pose_w[:, None, :2]
    turn = odom_pose[:, 2] - truth.robot_pose_w[:, 2]
    cos, sin = np.cos(turn)[:, None], np.sin(turn)[:, None]
    turned = np.stack([cos * off[..., 0] - sin * off[..., 1], sin * off[..., 0] + cos * off[..., 1]], axis=-1)
    return odom_pose[:, None, :2] + turned


def _visible(simulator: Simulator, frame: SensorFrame, run: TrackingRun) -> Iterable[Bool[np.ndarray, "P"]]:
    """Whom a sensor shows, world by world, by exact images and by the returns of legs."""
    people = simulator.people()
    images = simulator.images()
    near = np.isfinite(images.depth_m)
    for b in range(simulator.num_worlds):
        ids, pixels = np.unique(images.instance[b][near[b]], return_counts=True)
        shown = np.isin(people.id[b], ids[pixels >= _LEAST_PIXELS])
        if run.legs:
            shown |= rays_on_legs(simulator, b, frame.scan_m[b], run.sim.lidar) >= _LEAST_RAYS
        yield shown & people.active[b]


def _copy(found: Detections) -> Detections:
    return Detections(*(array.copy() for array in found))


class Followed(NamedTuple):
    """Everybody who counts and all tracks that do, at one instant of one world."""

    episode: int
    step: int
    pose: Float[np.ndarray, "3"]
    frame: TrackingFrame


def follow(
    moments: Sequence[Moment],
    run: TrackingRun,
    settings: TrackerSettings | None = None,
    hidden_s: float = math.inf,
) -> list[Followed]:
    """Tracks a recording, in the order of its episodes.

    A person counts who is within `WITHIN_M` of the robot, has been visible at least once, and has been hidden for no
    longer than `hidden_s`. A track counts that is confirmed and within `WITHIN_M`, or within `MATCH_M` of somebody who
    counts; but not one that follows somebody who does not.
    """
    tracker, result = Tracker(run.worlds, run.sim.threads, settings), []
    episode = np.full(run.worlds, -1)
    for step, moment in enumerate(moments):
        tracker.reset(moment.episode != episode)
        episode = moment.episode
        sightings = [Sighting(moment.camera, depth_view(moment.depth_m, run.sim.camera))]
        if moment.legs is not None:
            sightings.append(Sighting(moment.legs, lidar_view(moment.scan_m, run.sim.lidar)))
        tracks = tracker.update(moment.pose, run.sim.control_dt_s, sightings)
        for b in range(run.worlds):
            sure = tracks.confirmed[b]
            frame = _counted(moment, b, tracks.id[b, sure], tracks.state[b, sure, :2], hidden_s)
            result.append(Followed(int(episode[b]), step, moment.pose[b], frame))
    return sorted(result, key=lambda one: (one.episode, one.step))


def _counted(moment: Moment, b: int, track: np.ndarray, place: np.ndarray, hidden_s: float) -> TrackingFrame:
    person, pos, robot = moment.person[b], moment.person_pos[b], moment.pose[b, :2]
    hidden = moment.hidden_s[b]
    counts = (person >= 0) & np.isfinite(hidden) & (hidden <= hidden_s) & (np.hypot(*(pos - robot).T) < WITHIN_M)
    others = (person >= 0) & ~counts

    def near(some: np.ndarray) -> np.ndarray:
        return (np.hypot(*(place[:, None] - pos[some][None]).transpose(2, 0, 1)) < MATCH_M).any(axis=1)

    kept = near(counts) | ((np.hypot(*(place - robot).T) < WITHIN_M) & ~near(others))
    return TrackingFrame(person[counts], pos[counts].astype(float), track[kept], place[kept].copy())


def score(followed: Sequence[Followed], match_m: float = MATCH_M) -> TrackingScores:
    """Of all episodes together."""
    episodes: dict[int, list[TrackingFrame]] = {}
    for one in followed:
        episodes.setdefault(one.episode, []).append(one.frame)
    return pooled_scores([score_tracks(frames, match_m) for frames in episodes.values()])


def summary(parts: Sequence[tuple[Sequence[Moment], TrackingRun]], settings: TrackerSettings | None = None) -> dict:
    """`TrackingScores.summary` of several recordings together, `switches_per_100_s` for each person followed, and
    `mota_in_view`, `idf1_in_view`, `switches_in_view` over people hidden for no longer than `IN_VIEW_S`."""
    scores = pooled_scores([score(follow(moments, run, settings)) for moments, run in parts])
    in_view = pooled_scores([score(follow(moments, run, settings, IN_VIEW_S)) for moments, run in parts])
    seconds = scores.people * parts[0][1].sim.control_dt_s
    return scores.summary() | {
        "switches_per_100_s": 100.0 * scores.switches / max(seconds, 1e-9),
        "mota_in_view": in_view.mota,
        "idf1_in_view": in_view.idf1,
        "switches_in_view": float(in_view.switches),
    }


def evaluate_tracker(
    navigator: Navigator,
    source: PeopleSource,
    scenarios: Sequence[str] = TESTS,
    run: TrackingRun | None = None,
    settings: TrackerSettings | None = None,
) -> dict[str, dict[str, float]]:
    """Scores in each scenario, and of `all` together: see `summary`.

    Args:
        navigator: Drives the robots, with `run.sim.robot`.
        source: of the camera's detections, for `run.worlds` worlds.
        run: how much is recorded, with which sensors.
        settings: the tracker's; the shipped ones unless given.
    """
    run = run or TrackingRun()
    recorded = {name: (record(name, navigator, source, run), run) for name in scenarios}
    tables = {name: summary([part], settings) for name, part in recorded.items()}
    return tables | {"all": summary(list(recorded.values()), settings)}
