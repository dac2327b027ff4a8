"""Promises that all classical navigators keep, driven in small worlds."""

from __future__ import annotations

import numpy as np
import pytest

from densecavoid.baselines import Dwa, Frozone, GoToGoal, Lookahead, Orca, SocialForce
from densecavoid.benchmark.rollout import run_episodes
from densecavoid.frames import LidarConfig
from densecavoid.scenarios import make_scenario
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.people import STANDING
from densecavoid.sim.spec import Crowd, WorldSpec
from densecavoid.sim.world import SimConfig, Simulator

CONFIG = SimConfig(threads=1)
PATHFINDERS = {
    "dwa": Dwa,
    "social-force": SocialForce,
    "orca": Orca,
    "orca-privileged": lambda: Orca(source="truth"),
    "lookahead": Lookahead,
    "lookahead-privileged": lambda: Lookahead(source="truth"),
}
EVERYBODY = PATHFINDERS | {"frozone": lambda: Frozone(GoToGoal())}


class Course:
    """A goal 8 m ahead; a pillar, a person who stands, or a wall between, all a little to the right."""

    name = "course"

    def __init__(self, what: str) -> None:
        self.what = what

    def spawn(self, rng: np.random.Generator) -> WorldSpec:
        plan, crowd = FloorPlan(), Crowd.nobody()
        if self.what == "pillar":
            plan.pillar(4.0, -0.15, 0.3)
        elif self.what == "wall":
            plan.wall(4.0, -12.0, 4.0, 12.0)
        elif self.what == "person":
            place, one = np.array([[4.0, -0.15]]), np.ones(1)
            crowd = Crowd(place, place, 0.5 * one, 0.26 * one, 1.7 * one, np.full(1, STANDING), heading_rad=3.1 * one)
        return WorldSpec(self.name, plan, (0.0, 0.0, 0.0), (8.0, 0.0), crowd, time_limit_s=30.0)


def drive(make, what: str, config: SimConfig = CONFIG):
    (episode,) = run_episodes(Simulator(Course(what), 1, config), make(), [1])
    return episode


@pytest.mark.parametrize("name", EVERYBODY)
def test_reaches_a_free_goal_almost_straight(name):
    episode = drive(EVERYBODY[name], "nothing")
    assert episode.outcome == "success"
    assert episode.duration_s < 11.0 and np.abs(episode.pose_w[:, 1]).max() < 0.2


@pytest.mark.parametrize("what", ["pillar", "person"])
@pytest.mark.parametrize("name", PATHFINDERS)
def test_goes_round_what_stands_in_the_way(name, what):
    episode = drive(PATHFINDERS[name], what)
    assert episode.outcome == "success"
    assert np.abs(episode.pose_w[:, 1]).max() > 0.4


@pytest.mark.parametrize("dynamics", ["ideal", "dynamic"])
@pytest.mark.parametrize("name", EVERYBODY)
def test_brakes_before_a_wall(name, dynamics):
    episode = drive(EVERYBODY[name], "wall", SimConfig(threads=1, dynamics=dynamics))
    assert episode.outcome == "timeout"
    assert episode.clearance_m.min() > 0.30
    assert episode.pose_w[:, 0].max() > 2.0  # it went there


@pytest.mark.parametrize("name", EVERYBODY)
def test_limits_of_the_robot_are_kept_and_worlds_do_not_mix(name):
    """Three worlds at once and each alone: the same commands, all within the limits."""
    scenario, seeds = make_scenario("random-pedestrians"), [4, 5, 6]
    beside = run_episodes(Simulator(scenario, 3, CONFIG), EVERYBODY[name](), seeds)
    alone = run_episodes(Simulator(scenario, 1, CONFIG), EVERYBODY[name](), seeds[1:2])
    np.testing.assert_array_equal(beside[1].command, alone[0].command)
    for episode in beside:
        assert (episode.command[:, 0] >= 0.0).all() and (episode.command[:, 0] <= 1.0).all()
        assert (np.abs(episode.command[:, 1]) <= 0.4 + 1e-6).all()


def test_names_and_what_they_see():
    navigators = {name: make() for name, make in EVERYBODY.items()}
    assert {name: navigator.name for name, navigator in navigators.items()} == {name: name for name in navigators}
    assert navigators["orca-privileged"].privileged and not navigators["dwa"].privileged


@pytest.mark.parametrize("name", ["dwa", "social-force", "orca"])
def test_a_scan_of_another_lidar_is_refused(name):
    simulator = Simulator(Course("wall"), 1, SimConfig(threads=1, lidar=LidarConfig(num_rays=256)))
    with pytest.raises(ValueError, match="256"):
        run_episodes(simulator, PATHFINDERS[name](), [1])
