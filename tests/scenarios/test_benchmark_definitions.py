"""The definitions of the benchmark's worlds (docs: The four tests, Real crowds), number by number, on drawn worlds."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest

from densecavoid.frames import Command
from densecavoid.scenarios import make_scenario
from densecavoid.scenarios.free_space import clear_path
from densecavoid.sim.people import STANDING, TRAVERSING, WANDERING
from densecavoid.sim.spec import WorldSpec
from densecavoid.sim.world import Simulator

TESTS = ["dense-static", "random-sparse-ped", "dense-ped", "corridor-15"]
FREEZING = ["robot-freezing:0.5-1.0", "robot-freezing:1.0-1.5", "robot-freezing:1.5-2.0"]


@cache
def worlds(name: str) -> list[WorldSpec]:
    return [make_scenario(name).spawn(np.random.default_rng(seed)) for seed in range(60)]


@pytest.mark.parametrize("name", TESTS + FREEZING)
def test_rules_of_an_episode(name):
    for spec in worlds(name):
        assert (spec.time_limit_s, spec.collision_distance_m, spec.goal_distance_m) == (60.0, 0.30, 0.30)


def walls(spec: WorldSpec) -> np.ndarray:
    return spec.floor_plan.boxes[spec.floor_plan.boxes[:, 6] == 2.5]


def ahead(spec: WorldSpec) -> tuple[np.ndarray, float]:
    """How far ahead of the robot's start people and goal are, along the corridor."""
    return spec.crowd.pos[:, 0] - spec.start_pose[0], spec.goal[0] - spec.start_pose[0]


@pytest.mark.parametrize(
    ("name", "mean", "std", "far"), [("dense-ped", 0.33, 0.10, 23.0), ("corridor-15", 0.50, 0.15, 13.0)]
)
def test_corridors(name, mean, std, far):
    """4 m wide, 24 m long, 15 people against the robot from 3 m on, goal 15 m ahead."""
    speeds, places, crossing = [], [], []
    for spec in worlds(name):
        lower, upper = sorted(walls(spec).tolist(), key=lambda row: row[1])
        assert upper[1] - upper[4] - (lower[1] + lower[4]) == pytest.approx(4.0)
        for wall in (lower, upper):
            assert 2 * (wall[3] - wall[4]) == pytest.approx(24.0)  # a wall is longer than its line by its thickness
        people, goal = ahead(spec)
        assert spec.crowd.size == 15 and goal == pytest.approx(15.0)
        assert (spec.crowd.behaviour == TRAVERSING).all()
        assert people.min() >= 3.0 and people.max() <= far
        assert (spec.crowd.goal[:, 0] < spec.start_pose[0] - 3.0).all()
        speeds += spec.crowd.preferred_speed.tolist()
        places += ((people - 3.0) / (far - 3.0)).tolist()
        crossing += spec.crowd.pos[:, 1].tolist()
    expected = np.clip(np.random.default_rng(1).normal(mean, std, 200_000), 0.15, 1.6)
    assert np.mean(speeds) == pytest.approx(expected.mean(), abs=0.012)
    assert np.std(speeds) == pytest.approx(expected.std(), abs=0.012)
    assert min(speeds) >= 0.15 and max(speeds) <= 1.6
    assert np.mean(places) == pytest.approx(0.5, abs=0.04) and np.mean(crossing) == pytest.approx(0.0, abs=0.1)


def test_random_sparse_ped():
    """Hall of 8 x 8 m, a few pillars, ten people at N(.5, .15) m/s who change their mind, goal about 5 m away."""
    speeds, distances = [], []
    for spec in worlds("random-sparse-ped"):
        inner = [np.abs(row[:2] - 4.0).max() - row[4] for row in walls(spec)]
        np.testing.assert_allclose(inner, 4.0)
        assert len(walls(spec)) == len(spec.floor_plan.boxes) == 4
        assert 2 <= len(spec.floor_plan.cylinders) <= 4
        assert spec.crowd.size == 10 and (spec.crowd.behaviour == WANDERING).all()
        assert spec.crowd.changes_of_mind_per_s > 0
        for place in (spec.crowd.pos, spec.crowd.goal):
            assert place.min() > 0.5 and place.max() < 7.5
        speeds += spec.crowd.preferred_speed.tolist()
        distances.append(math.dist(spec.start_pose[:2], spec.goal))
    assert np.mean(speeds) == pytest.approx(0.5, abs=0.02) and np.std(speeds) == pytest.approx(0.15, abs=0.015)
    assert min(speeds) >= 0.15 and max(speeds) <= 1.6
    assert min(distances) >= 4.5 and max(distances) <= 5.5


def obstacles(spec: WorldSpec) -> dict[str, int]:
    """How many boxes, pillars, tables and chairs stand there, told by their shapes."""
    boxes = spec.floor_plan.boxes
    bottom, top, half = boxes[:, 5], boxes[:, 6], boxes[:, 3]
    return {
        "table": int(np.isclose(bottom, 0.70).sum()),
        "chair": int(np.isclose(bottom, 0.42).sum()),
        "pillar": len(spec.floor_plan.cylinders),
        "box": int(((bottom == 0) & (top < 2.5) & (half > 0.1)).sum()),
    }


def test_dense_static():
    """10 x 10 m, 25 to 35 obstacles of four kinds, ends at least 6 m apart, a way of .45 m, tight gaps common."""
    kinds: dict[str, int] = {}
    tight = 0
    some = worlds("dense-static")[:30]
    for spec in some:
        inner = [np.abs(row[:2] - 5.0).max() - row[4] for row in walls(spec)]
        np.testing.assert_allclose(inner, 5.0)
        here = obstacles(spec)
        assert 25 <= sum(here.values()) <= 35
        kinds = {kind: kinds.get(kind, 0) + count for kind, count in here.items()}
        start, goal = spec.start_pose[:2], spec.goal
        assert math.dist(start, goal) >= 6.0
        assert clear_path(spec.floor_plan, start, goal, (0.0, 0.0, 10.0, 10.0), 0.45) is not None
        # The widest way there is leads through a gap of 1.1 m or less.
        tight += clear_path(spec.floor_plan, start, goal, (0.0, 0.0, 10.0, 10.0), 0.56, 0.05) is None
    assert min(kinds.values()) > 3 * len(some)
    assert tight / len(some) > 0.5


@pytest.mark.parametrize("name", FREEZING)
def test_robot_freezing(name):
    """Corridor 4 m wide, goal 10 m ahead; 3 or 4 people side by side, too near to pass between, 1 m free beside."""
    low, high = map(float, name.split(":")[1].split("-"))
    distances = []
    for spec in worlds(name):
        lower, upper = sorted(walls(spec).tolist(), key=lambda row: row[1])
        assert upper[1] - upper[4] - (lower[1] + lower[4]) == pytest.approx(4.0)
        assert spec.goal[0] - spec.start_pose[0] == pytest.approx(10.0)
        assert spec.appearance is not None and spec.appearance.trigger_distance_m == 3.0
        distances.append(spec.appearance.distance_m)
        crowd = spec.crowd
        assert crowd.size in (3, 4) and (crowd.behaviour == STANDING).all()
        order = np.argsort(crowd.pos[:, 1])
        y, radius = crowd.pos[order, 1], crowd.radius_m[order]
        between = np.diff(y) - radius[1:] - radius[:-1]
        assert between.min() > 0.0 and between.max() < 2 * 0.30  # the paper's rule lets nobody through
        beside = 2.0 - (y + radius).max(), (y - radius).min() + 2.0
        assert max(beside) >= 1.0 - 1e-9 and min(beside) > 0.0
        assert (y - radius).min() < 0.0 < (y + radius).max()  # across the robot's way
    assert low <= min(distances) and max(distances) <= high
    assert np.mean(distances) == pytest.approx((low + high) / 2, abs=0.06)


@pytest.mark.parametrize("name", FREEZING)
def test_those_who_appear_stay_where_they_are(name):
    simulator = Simulator(make_scenario(name), 4)
    simulator.reset(np.arange(4))
    while np.isnan(simulator.spawn_time_s).any():
        simulator.step(Command(np.ones(4), np.zeros(4)))
    before = simulator.people()
    pos, there = before.pos_w.copy(), before.active.copy()
    for _ in range(50):
        simulator.step(Command(np.zeros(4), np.zeros(4)))
    np.testing.assert_array_equal(simulator.people().pos_w[there], pos[there])


@pytest.mark.parametrize("reactive", ["", ":reactive"])
def test_hermes(data_dir, reactive):
    """One end of the corridor to the other, 12 m, after the first tenth of the run, contact rule, 90 s."""
    scenario = make_scenario(f"hermes:bo-360-050-050{reactive}", data_dir)
    ends = set()
    for seed in range(20):
        spec = scenario.spawn(np.random.default_rng(seed))
        assert abs(spec.start_pose[1]) == 6.0 and spec.goal[1] == -spec.start_pose[1]
        ends.add(spec.start_pose[1])
        assert (spec.time_limit_s, spec.collision_distance_m) == (90.0, 0.18)
        assert spec.replay is not None and spec.replay.reactive == (reactive != "")
        assert spec.replay.start_s >= 0.1 * spec.replay.recording.duration_s
        left, right = sorted(spec.floor_plan.boxes.tolist())
        assert left[0] + left[4] == pytest.approx(0.0) and right[0] - right[4] == pytest.approx(3.6)
        assert 2 * (left[3] - left[4]) == pytest.approx(8.0)
        assert 0.0 < spec.start_pose[0] < 3.6
    assert ends == {-6.0, 6.0}
