"""The planner that knows the future: its plans are driven, its futures compared with the simulator's own."""

from __future__ import annotations

import math

import numpy as np
import pytest

from densecavoid.benchmark.navigators import make_navigator
from densecavoid.benchmark.rollout import run_episodes
from densecavoid.foresight import lattice
from densecavoid.foresight.future import foresee, solid_bodies
from densecavoid.foresight.planner import find_way, judge_worlds, terrain_of
from densecavoid.frames import Command
from densecavoid.scenarios import make_scenario
from densecavoid.sim.config import SimConfig
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.people import STANDING
from densecavoid.sim.spec import Crowd, WorldSpec
from densecavoid.sim.world import Simulator

TESTS = ["dense-static", "random-sparse-ped", "dense-ped", "corridor-15", "robot-freezing:0.5-1.0"]
CONFIG = SimConfig(threads=1)


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setattr("densecavoid.benchmark.solvable.user_cache", lambda: tmp_path)


def replay(scenario, seeds, config=CONFIG):
    return run_episodes(Simulator(scenario, 2, config), make_navigator("oracle"), seeds)


@pytest.mark.parametrize("name", TESTS)
def test_a_plan_replayed_succeeds_in_the_time_it_says(name):
    scenario, seeds = make_scenario(name), [3, 4]
    for episode, judgement in zip(replay(scenario, seeds), judge_worlds(scenario, seeds, CONFIG), strict=True):
        if judgement.plan is None:
            assert episode.outcome != "success" and not episode.velocity.any()
        else:
            assert episode.outcome == "success"
            assert episode.duration_s == pytest.approx(judgement.plan.time_s)
            assert episode.clearance_m.min() >= 0.30
            assert episode.command[:, 0].min() >= 0 and episode.command[:, 0].max() <= 1.0
            assert np.abs(episode.command[:, 1]).max() <= 0.4 + 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("name", [*TESTS, "robot-freezing:1.0-1.5", "robot-freezing:1.5-2.0", "lobby", "crossing"])
def test_plans_of_many_worlds_replay_exactly(name):
    scenario, seeds = make_scenario(name), list(range(500, 510))
    plans = [judgement.plan for judgement in judge_worlds(scenario, seeds, CONFIG)]
    for episode, plan in zip(replay(scenario, seeds), plans, strict=True):
        assert (episode.outcome == "success") == (plan is not None)
        assert plan is None or episode.duration_s == pytest.approx(plan.time_s)


def test_recorded_people_too(data_dir):
    scenario = make_scenario("hermes:bo-360-050-050", data_dir)
    seeds = [1, 2]
    plans = [judgement.plan for judgement in judge_worlds(scenario, seeds, CONFIG)]
    assert [episode.outcome == "success" for episode in replay(scenario, seeds)] == [p is not None for p in plans]
    assert any(plan is not None for plan in plans)


@pytest.mark.parametrize("name", ["random-sparse-ped", "corridor-15"])
def test_the_future_is_what_happens_around_a_robot_that_drives(name):
    """At every control step the bodies are, to the bit, where they were foreseen."""
    scenario = make_scenario(name)
    (future,) = foresee(scenario, [11], CONFIG)
    simulator = Simulator(scenario, 1, CONFIG)
    simulator.reset(np.array([11]))
    for k in range(150):
        simulator.step(Command(np.array([0.05]), np.array([0.4])))
        if simulator.done[0]:
            break
        np.testing.assert_array_equal(solid_bodies(simulator, 0).astype(np.float32), future.bodies[2 * k + 1])
    assert simulator.time_s[0] > 2.0


class Blocked:
    """A corridor 2 m wide with two people side by side: no way through for a disc of .3 m."""

    name = "blocked"

    def __init__(self, gap_m: float) -> None:
        self.gap_m = gap_m

    def spawn(self, rng: np.random.Generator) -> WorldSpec:
        plan = FloorPlan()
        for y in (-1.05, 1.05):
            plan.wall(-3.0, y, 8.0, y)
        place = np.array([[3.0, 0.25 + self.gap_m / 2], [3.0, -0.25 - self.gap_m / 2]])
        two = np.ones(2)
        crowd = Crowd(place, place, 0.5 * two, 0.25 * two, 1.7 * two, np.full(2, STANDING), heading_rad=0 * two)
        return WorldSpec(self.name, plan, (0.0, 0.0, 0.0), (6.0, 0.0), crowd, time_limit_s=20.0)


def test_finds_a_gap_and_says_when_there_is_none():
    """People's shoulders lie across the corridor: a gap of .64 m lets a robot through that needs .60, one of .5 not."""
    (wide,), (narrow,) = (judge_worlds(Blocked(gap), [0], CONFIG) for gap in (0.64, 0.5))
    assert wide.plan is not None and narrow.plan is None
    # 6 m less the goal's .3 m, at 1 m/s.
    assert wide.plan.time_s == pytest.approx(5.7, abs=0.25)


def test_density_by_hand():
    """Two people within 1.5 m of a line of 6 m, on ground of which two walls of .1 m take their part."""
    (judgement,) = judge_worlds(Blocked(0.64), [0], CONFIG)
    walls_m2 = 2 * 0.1 * (6.0 + 2 * math.sqrt(1.5**2 - 1.05**2))
    area_m2 = 6.0 * 3.0 + math.pi * 1.5**2 - walls_m2
    assert judgement.density_per_m2 == pytest.approx(2 / area_m2, rel=0.03)


def test_an_empty_place_takes_the_shortest_time():
    """A goal 4 m behind: turning by pi at .4 rad/s, on the spot or on the way, and 3.7 m of driving."""
    spec = WorldSpec("empty", FloorPlan(), (0.0, 0.0, 0.0), (-4.0, 0.0))
    terrain = terrain_of(spec.floor_plan, spec, np.array(spec.goal))
    nobody = np.zeros((0, 0, 3), np.float32)
    way = find_way(terrain, np.zeros(3), nobody, False, spec, CONFIG, 60.0)
    assert way is not None
    assert math.pi / 0.4 - 0.5 < 0.1 * len(way) < math.pi / 0.4 + 3.7 + 0.5


def test_shortest_ways_go_around_walls():
    """From one side of a wall to the other: straight to its end, and straight on (within the grid's error)."""
    free = np.ones((41, 41), bool)
    free[20, :31] = False
    ways = lattice.shortest_ways(free, 10, 10, 1.0)
    corner = math.hypot(10, 21)
    assert ways[30, 10] == pytest.approx(2 * corner, rel=0.06)
    assert ways[10, 30] == pytest.approx(20, rel=0.01)
    assert np.isinf(ways[20, 5])
    closed = free.copy()
    closed[20] = False
    assert np.isinf(lattice.shortest_ways(closed, 10, 10, 1.0)[30, 10])
