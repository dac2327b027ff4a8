"""What people do besides walking: think of the robot, keep a pace, walk in groups, talk, and come in again."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from small_worlds import crowd, go, simulate

from densecavoid.scenarios import make_scenario
from densecavoid.sim.config import Attitudes, AttitudeShares, SimConfig
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.people import BLOCK, CIRCULATING, IGNORE, STANDING, TRAVERSING, YIELD
from densecavoid.sim.world import Simulator

QUIET: dict[str, Any] = {"collision_distance_m": 1e-6}  # nothing ends the episode


def one_towards_a_standing_robot(people: Attitudes, shares: AttitudeShares | None = None):
    config = SimConfig(threads=1, people=people, shares=shares or AttitudeShares())
    return simulate(
        crowd([[5.0, 0.02]], [[-9.0, 0.02]]), config=config, start_pose=(0.0, 0.0, 0.0), goal=(90.0, 0.0), **QUIET
    )


def test_people_who_ignore_the_robot_walk_through_it_and_who_yield_walk_around_it():
    nearest = {}
    kinds: tuple[Attitudes, ...] = ("scripted", "reactive")
    for people in kinds:
        sim = one_towards_a_standing_robot(people)
        distances = []
        for _ in range(100):
            go(sim, 0.1)
            distances.append(math.hypot(*sim._state.pos[0, 0]))
        assert sim._state.pos[0, 0, 0] < -1.0
        nearest[people] = min(distances)
    assert nearest["scripted"] < 0.1
    assert nearest["reactive"] > 0.25 + 0.18


def test_a_curious_person_stops_in_front_of_the_robot_looks_at_it_and_goes_on_in_the_end():
    sim = one_towards_a_standing_robot("mixed", AttitudeShares(0.0, 0.0, 1.0))
    state = sim._state
    assert state.attitude[0, 0] == BLOCK
    state.robot_pose[0] = (0.0, 1.0, 0.3)
    go(sim, 8.0)
    bearing = math.atan2(state.pos[0, 0, 1] - 1.0, state.pos[0, 0, 0])
    apart = math.hypot(state.pos[0, 0, 0], state.pos[0, 0, 1] - 1.0)
    assert bearing == pytest.approx(0.3, abs=0.1)
    assert 0.25 + 0.18 < apart < 1.5
    assert math.hypot(*state.vel[0, 0]) < 0.1
    facing = math.cos(state.heading[0, 0] - (bearing + math.pi))
    assert facing > 0.95
    go(sim, 12.0)
    assert state.attitude[0, 0] == YIELD and state.pos[0, 0, 0] < -1.0


def test_shares_of_attitudes_are_kept_and_change_nothing_else():
    shares = AttitudeShares(0.3, 0.5, 0.2)
    counts = np.zeros(3)
    for seed in range(60):
        sims = [
            Simulator(make_scenario("dense-ped"), 1, SimConfig(threads=1, people=p, shares=shares))
            for p in ("mixed", "scripted")
        ]
        for sim in sims:
            sim.reset(np.array([seed]))
        mixed, plain = (sim._state for sim in sims)
        for name in ("pos", "person_goal", "preferred_speed", "radius", "phase", "random", "robot_pose", "goal"):
            np.testing.assert_array_equal(getattr(mixed, name), getattr(plain, name))
        assert (plain.attitude == IGNORE).all()
        counts += np.bincount(mixed.attitude[0], minlength=3)
    share, error = counts / counts.sum(), 3.5 * np.sqrt(0.25 / counts.sum())
    np.testing.assert_allclose(share, [0.3, 0.5, 0.2], atol=error)


@pytest.mark.parametrize(("pace", "mean", "std"), [("brisk", 1.0, 0.2), ("rush", 1.34, 0.26)])
def test_pace_draws_everybodys_speed_anew_in_the_same_world(pace, mean, std):
    speeds = []
    for seed in range(40):
        sims = [Simulator(make_scenario("dense-ped"), 1, SimConfig(threads=1, pace=p)) for p in (pace, "scenario")]
        for sim in sims:
            sim.reset(np.array([seed]))
        np.testing.assert_array_equal(sims[0]._state.pos, sims[1]._state.pos)
        speeds.append(sims[0]._state.preferred_speed[0])
    speed = np.concatenate(speeds)
    reference = np.clip(np.random.default_rng(0).normal(mean, std, 200_000), 0.15, 1.6)
    assert speed.mean() == pytest.approx(reference.mean(), abs=4 * std / math.sqrt(len(speed)))
    assert speed.std() == pytest.approx(reference.std(), rel=0.12)
    assert speed.max() <= 1.6


def test_a_group_walks_abreast_at_the_slowest_members_speed_and_waits():
    people = crowd(
        [[0.0, 0.0], [-1.5, 0.3], [0.5, -0.4]], [[90.0, 0.0]] * 3, speed=[1.4, 0.9, 1.2], group=np.array([4, 4, 4])
    )
    sim = simulate(people)
    go(sim, 10.0)
    pos, vel = sim._state.pos[0], sim._state.vel[0]
    assert np.ptp(pos[:, 0]) < 0.15  # abreast
    assert np.diff(np.sort(pos[:, 1])) == pytest.approx([0.7, 0.7], abs=0.15)
    np.testing.assert_allclose(np.hypot(*vel.T), 0.9, atol=0.05)


def test_strangers_do_not_wait():
    sim = simulate(crowd([[0.0, 0.0], [-1.5, 0.9]], [[90.0, 0.0], [90.0, 0.9]], speed=[1.4, 0.9]))
    go(sim, 10.0)
    assert sim._state.pos[0, 0, 0] - sim._state.pos[0, 1, 0] > 5.0


def test_talkers_stay_and_face_each_other_whoever_walks_by():
    people = crowd(
        [[0.0, 0.0], [0.8, 0.0], [-5.0, 0.1]],
        [[0.0, 0.0], [0.8, 0.0], [9.0, 0.1]],
        behaviour=[STANDING, STANDING, TRAVERSING],
        heading_rad=np.array([0.0, math.pi, 0.0]),
        group=np.array([0, 0, -1]),
    )
    sim = simulate(people)
    go(sim, 12.0)
    np.testing.assert_array_equal(sim._state.pos[0, :2], people.pos[:2])
    np.testing.assert_array_equal(sim._state.heading[0, :2], [0.0, math.pi])
    assert sim._state.pos[0, 2, 0] > 4.0


def test_circulating_people_enter_again_where_they_began_once_there_is_room_and_are_new_to_who_watches():
    people = crowd([[0.0, 0.0], [0.0, 5.0]], [[3.0, 0.0], [0.0, 5.0]], behaviour=[CIRCULATING, STANDING])
    sim = simulate(people)
    state = sim._state
    go(sim, 2.5)
    assert state.person_id[0, 0] == 0
    go(sim, 1.0)
    assert state.behaviour[0, 0] == CIRCULATING and state.person_id[0, 0] == 2 and state.pos[0, 0, 0] < 1.5
    state.pos[0, 1] = (0.1, 0.0)  # somebody stands in the entrance
    go(sim, 6.0)
    assert not sim.people().active[0, 0]
    state.pos[0, 1] = (0.0, 5.0)
    go(sim, 0.2)
    assert sim.people().active[0, 0] and state.person_id[0, 0] == 3


def test_circulating_people_come_in_at_their_entrance_where_one_is_given():
    people = crowd([[0.0, 0.0]], [[3.0, 0.0]], behaviour=CIRCULATING, entrance=np.array([[-6.0, 1.0]]))
    sim = simulate(people)
    go(sim, 3.5)
    x, y = sim._state.pos[0, 0]
    assert sim._state.person_id[0, 0] == 1 and x < -5.0 and abs(y - 1.0) < 0.3


def test_a_crowd_that_circulates_keeps_flowing():
    rng = np.random.default_rng(0)
    count, plan = 20, FloorPlan()
    for y in (-0.05, 3.05):
        plan.wall(-1.0, y, 13.0, y)
    pos = np.stack([np.repeat(np.linspace(0.0, 3.2, 5), 4), np.tile([0.4, 1.1, 1.9, 2.6], 5)], axis=1)
    goal = np.stack([np.full(count, 12.0), pos[:, 1]], axis=1)
    sim = simulate(crowd(pos, goal, rng.uniform(0.9, 1.5, count), CIRCULATING), plan)
    for _ in range(6):
        go(sim, 10.0)
        assert sim.people().active[0].mean() > 0.8
    assert sim._state.person_id[0].max() > 4 * count


def test_bad_values_are_refused_by_name():
    with pytest.raises(ValueError, match="sum is"):
        AttitudeShares(0.5, 0.5, 0.5)
    with pytest.raises(ValueError, match=r"AttitudeShares\.block is -0\.2"):
        AttitudeShares(0.6, 0.6, -0.2)
    with pytest.raises(ValueError, match=r"radius_m"):
        crowd([[0.0, 0.0]], [[1.0, 0.0]], radius=0.6)
    with pytest.raises(ValueError, match=r"preferred_speed"):
        crowd([[0.0, 0.0]], [[1.0, 0.0]], speed=-1.0)
