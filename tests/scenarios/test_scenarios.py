"""Every scenario: it is drawn, can be begun, and is what BENCHMARK says."""

from __future__ import annotations

import math

import numpy as np
import pytest

from densecavoid.scenarios import TESTING, TRAINING, make_scenario, names
from densecavoid.scenarios.free_space import clear_path, free_points, points_along
from densecavoid.scenarios.mixture import Mixture
from densecavoid.sim.clearance import clearances_m
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.world import Simulator


@pytest.mark.parametrize("name", names())
def test_worlds_begin_clear_and_repeat_with_their_seed(name):
    scenario = make_scenario(name)
    assert scenario.name == name
    for seed in range(8):
        spec, again = (scenario.spawn(np.random.default_rng(seed)) for _ in range(2))
        assert spec.start_pose == again.start_pose
        np.testing.assert_array_equal(spec.floor_plan.boxes, again.floor_plan.boxes)
        np.testing.assert_array_equal(spec.crowd.pos, again.crowd.pos)
        ends = np.array([spec.start_pose[:2], spec.goal])
        assert (clearances_m(spec.floor_plan, ends) >= 0.35).all()
        if spec.crowd.size and spec.appearance is None:
            assert (clearances_m(spec.floor_plan, spec.crowd.pos) >= spec.crowd.radius_m).all()
            assert np.hypot(*(spec.crowd.pos - ends[0]).T).min() > 1.2


@pytest.mark.parametrize("name", names())
def test_the_robot_does_not_begin_in_a_collision(name):
    sim = Simulator(make_scenario(name), 16)
    sim.reset(np.arange(16))
    assert (sim.clearance_m > 0.35).all() and not sim.done.any()


def test_dense_static_is_cluttered_and_passable():
    counts = []
    for seed in range(10):
        spec = make_scenario("dense-static").spawn(np.random.default_rng(seed))
        assert math.dist(spec.start_pose[:2], spec.goal) >= 6.0
        path = clear_path(spec.floor_plan, spec.start_pose[:2], spec.goal, (0, 0, 10, 10), 0.45)
        assert path is not None
        assert clearances_m(spec.floor_plan, path[1:-1]).min() >= 0.45
        counts.append(len(spec.floor_plan.boxes) + len(spec.floor_plan.cylinders) - 4)
    assert np.mean(counts) > 25


def test_corridors_hold_fifteen_people_ahead_at_the_given_speed():
    for name, mean, far in (("dense-ped", 0.33, 23.0), ("corridor-15", 0.5, 13.0)):
        specs = [make_scenario(name).spawn(np.random.default_rng(s)) for s in range(40)]
        ahead = np.concatenate([spec.crowd.pos[:, 0] - spec.start_pose[0] for spec in specs])
        assert all(spec.crowd.size == 15 for spec in specs)
        assert ahead.min() >= 3.0 and ahead.max() <= far
        assert np.mean([spec.crowd.preferred_speed.mean() for spec in specs]) == pytest.approx(mean, abs=0.03)


@pytest.mark.parametrize("name", list(TRAINING))
def test_training_scenarios_grow_with_their_level(name):
    def difficulty(level: float) -> float:
        specs = [TRAINING[name].at_level(level).spawn(np.random.default_rng(s)) for s in range(40)]
        return float(
            np.mean([len(s.floor_plan.boxes) + 5 * s.crowd.size + math.dist(s.start_pose[:2], s.goal) for s in specs])
        )

    assert difficulty(0.0) < difficulty(0.5) < difficulty(1.0)
    with pytest.raises(ValueError, match=r"level is 1\.5"):
        TRAINING[name].at_level(1.5)


def test_training_and_testing_worlds_carry_different_names():
    assert not set(TRAINING) & set(TESTING)
    assert len(TRAINING) == 4


def test_mixture_draws_in_proportion():
    mixture = Mixture((TRAINING["random-goal"], TRAINING["random-pedestrians"]), (3.0, 1.0))
    drawn = [mixture.spawn(np.random.default_rng(s)).scenario for s in range(400)]
    assert drawn.count("random-goal") / 400 == pytest.approx(0.75, abs=0.07)


def test_unknown_scenario_says_what_there_is():
    with pytest.raises(ValueError, match=r"unknown scenario 'dense', expected one of: random-goal.*hermes"):
        make_scenario("dense")


def test_no_room_is_an_error_and_not_an_endless_search():
    plan = FloorPlan()
    plan.box(0.0, 0.0, 10.0, 10.0)
    with pytest.raises(ValueError, match="no room for 3 places"):
        free_points(np.random.default_rng(0), plan, (-4, -4, 4, 4), 3, 0.3)


def test_clear_path_goes_around_a_wall_and_reports_a_closed_one():
    plan = FloorPlan()
    plan.box(0.0, 1.0, 0.2, 6.0)  # a wall from y = -2 to 4, open below
    area = (-4.0, -4.0, 4.0, 4.0)
    path = clear_path(plan, (-3.0, 0.0), (3.0, 0.0), area, 0.3)
    assert path is not None
    assert path[:, 1].min() < -2.2
    # by hand: twice from (3, 0) to the corner, over an 8-connected grid at most 8 % longer
    straight = 2 * math.hypot(3.0, 2.3)
    length = np.hypot(*np.diff(path, axis=0).T).sum()
    assert straight - 0.3 < length < 1.1 * straight
    plan.box(0.0, -3.0, 0.2, 4.0)
    assert clear_path(plan, (-3.0, 0.0), (3.0, 0.0), area, 0.3) is None


def test_points_along_a_path_by_hand():
    path = np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 4.0]])
    np.testing.assert_allclose(
        points_along(path, 2.0), [[2.0, 0.0], [3.0, 1.0]]
    )  # the next would be 1 m before the end
