"""Places of everyday life: they can be begun and crossed, people are in natural places and get about."""

from __future__ import annotations

import math

import numpy as np
import pytest

from densecavoid.frames import Command
from densecavoid.scenarios import PLACES
from densecavoid.scenarios.free_space import clear_path, way_is_clear
from densecavoid.scenarios.walk_net import BODY_ROOM_M, walk_net
from densecavoid.sim.clearance import FOR_PEOPLE, clearances_m
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.people import STANDING, WANDERING
from densecavoid.sim.spec import WorldSpec
from densecavoid.sim.world import SimConfig, Simulator


def bounds(spec: WorldSpec) -> tuple[float, float, float, float]:
    points = np.vstack([spec.floor_plan.boxes[:, :2], [spec.start_pose[:2]], [spec.goal]])
    (x0, y0), (x1, y1) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    return x0 - 1, y0 - 1, x1 + 1, y1 + 1


@pytest.mark.parametrize("level", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("name", list(PLACES))
def test_every_place_can_be_begun_and_crossed(name, level):
    scenario = PLACES[name].at_level(level)
    simulator = Simulator(scenario, 1, SimConfig(threads=1))
    for seed in range(8):
        spec = scenario.spawn(np.random.default_rng(seed))
        simulator.reset(np.array([seed]))  # refuses whoever starts inside something
        assert simulator.clearance_m[0] > 0.35 and not simulator.done[0]
        path = clear_path(spec.floor_plan, spec.start_pose[:2], spec.goal, bounds(spec), 0.35, 0.05)
        assert path is not None
        assert math.dist(spec.start_pose[:2], spec.goal) > 3.0
        assert np.isfinite(spec.time_limit_s)


@pytest.mark.parametrize("name", list(PLACES))
def test_the_way_past_those_who_stand_stays_open(name):
    for seed in range(8):
        spec = PLACES[name].spawn(np.random.default_rng(seed))
        plan = spec.floor_plan.copy()
        for k in np.flatnonzero(spec.crowd.behaviour == STANDING):
            plan.pillar(float(spec.crowd.pos[k, 0]), float(spec.crowd.pos[k, 1]), float(spec.crowd.radius_m[k]))
        assert clear_path(plan, spec.start_pose[:2], spec.goal, bounds(spec), 0.35, 0.05) is not None


@pytest.mark.parametrize("name", list(PLACES))
def test_worlds_repeat_with_their_seed_to_the_last_bit(name):
    first, second = (PLACES[name].spawn(np.random.default_rng(11)) for _ in range(2))
    other = PLACES[name].spawn(np.random.default_rng(12))
    np.testing.assert_array_equal(first.floor_plan.boxes, second.floor_plan.boxes)
    np.testing.assert_array_equal(first.floor_plan.cylinders, second.floor_plan.cylinders)
    for field in ("pos", "goal", "preferred_speed", "radius_m", "height_m", "behaviour", "heading_rad", "group"):
        np.testing.assert_array_equal(getattr(first.crowd, field), getattr(second.crowd, field))
    assert (first.start_pose, first.goal) == (second.start_pose, second.goal)
    assert first.start_pose != other.start_pose


@pytest.mark.parametrize("name", list(PLACES))
def test_places_grow_with_their_level(name):
    def people(level: float) -> float:
        specs = [PLACES[name].at_level(level).spawn(np.random.default_rng(s)) for s in range(8)]
        return float(np.mean([spec.crowd.size for spec in specs]))

    assert people(0.0) < people(0.5) < people(1.0)


@pytest.mark.parametrize("name", [name for name in PLACES if name != "crossing"])
def test_walkers_find_every_leg_of_their_way_free(name):
    for seed in range(10):
        spec = PLACES[name].spawn(np.random.default_rng(seed))
        net, leg = spec.crowd.net, spec.crowd.leg
        assert net is not None and leg is not None
        walking = spec.crowd.behaviour == WANDERING
        assert (leg[walking] >= 0).all() and (leg[~walking] == -1).all()
        for a, row in enumerate(net.links):
            for b in row[row >= 0]:
                assert a in net.links[b]  # ways lead both ways
                ends = net.places[a, :2], net.places[b, :2]
                assert way_is_clear(spec.floor_plan, *ends, (BODY_ROOM_M, BODY_ROOM_M))
        for k in np.flatnonzero(walking):
            a, b = leg[k]
            assert b in net.links[a]
            assert math.dist(spec.crowd.goal[k], net.places[b, :2]) <= net.places[b, 2] + 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("name", ["doorway", "l-corridor"])
def test_people_pass_the_door_and_the_corner_both_ways(name):
    """Over two minutes at level .5, and nobody ever stands in a wall."""
    simulator = Simulator(PLACES[name].at_level(0.5), 6, SimConfig(threads=1))
    simulator.reset(np.arange(6))
    people = simulator.people()
    walking = people.active & (np.hypot(*people.vel_w.transpose(2, 0, 1)) > 0)
    side_of = (lambda p: p[..., 0] > 0) if name == "doorway" else (lambda p: np.abs(p[..., 1]) > 4.0)
    before, passed = side_of(people.pos_w), {True: 0, False: 0}
    for step in range(1200):
        simulator.step(Command(np.zeros(6), np.zeros(6)))
        pos = simulator.people().pos_w
        after = side_of(pos)
        for direction in passed:
            passed[direction] += int(((after != before) & (after == direction) & walking).sum())
        before = after
        if step % 100 == 99:
            for b in range(6):
                here = pos[b, people.active[b]].astype(np.float64)
                room = clearances_m(simulator.floor_plan(b), here, 1.0, FOR_PEOPLE)
                assert (room >= people.radius_m[b, people.active[b]] - 0.06).all()
    assert min(passed.values()) >= 12


def test_talkers_face_each_other_about_a_metre_apart():
    gaps, misses = [], []
    for seed in range(20):
        crowd = PLACES["lobby"].spawn(np.random.default_rng(seed)).crowd
        assert crowd.group is not None and crowd.heading_rad is not None
        for group in set(crowd.group.tolist()) - {-1}:
            members = np.flatnonzero(crowd.group == group)
            assert 2 <= len(members) <= 4 and (crowd.behaviour[members] == STANDING).all()
            centre = crowd.pos[members].mean(axis=0)
            to_centre = centre - crowd.pos[members]
            angle = np.arctan2(to_centre[:, 1], to_centre[:, 0]) - crowd.heading_rad[members]
            misses += np.abs((angle + np.pi) % (2 * np.pi) - np.pi).tolist()
            apart = np.hypot(*(crowd.pos[members][:, None] - crowd.pos[members]).transpose(2, 0, 1))
            gaps += apart[apart > 0].reshape(len(members), -1).min(axis=1).tolist()
    assert len(misses) > 60
    assert max(misses) < math.radians(35)
    assert 0.8 < np.mean(gaps) < 1.2 and min(gaps) > 0.6


def test_pairs_of_a_flow_walk_side_by_side_to_the_same_end():
    pairs = 0
    for seed in range(10):
        crowd = PLACES["crossing"].spawn(np.random.default_rng(seed)).crowd
        assert crowd.group is not None
        for group in set(crowd.group.tolist()) - {-1}:
            a, b = np.flatnonzero(crowd.group == group)
            assert math.dist(crowd.pos[a], crowd.pos[b]) == pytest.approx(0.72)
            np.testing.assert_allclose(crowd.goal[a] - crowd.pos[a], crowd.goal[b] - crowd.pos[b])
            assert crowd.preferred_speed[a] == crowd.preferred_speed[b]
            pairs += 1
    assert pairs > 10


def test_crossing_flow_comes_at_right_angles_to_the_robots_way():
    for seed in range(10):
        spec = PLACES["crossing"].spawn(np.random.default_rng(seed))
        way = np.array(spec.goal) - spec.start_pose[:2]
        walk = spec.crowd.goal - spec.crowd.pos
        cosine = walk @ way / np.hypot(*walk.T) / np.hypot(*way)
        assert (np.abs(cosine) < 0.35).mean() > 0.5


def test_plaza_has_low_things_that_the_lidar_looks_over_and_no_ceiling():
    for seed in range(10):
        plan = PLACES["plaza"].spawn(np.random.default_rng(seed)).floor_plan
        tops = plan.boxes[:, 6]
        assert math.isinf(plan.ceiling_m)
        kerbs = (tops >= 0.10) & (tops <= 0.15)
        assert kerbs.sum() >= 6
        assert ((plan.boxes[:, 5] == 0) & (tops < 0.09)).sum() >= 4  # the lower steps of ramps


def test_doorway_narrows_to_a_door_of_about_a_metre():
    for level, widest in ((0.0, 2.0), (1.0, 1.35)):
        for seed in range(10):
            plan = PLACES["doorway"].at_level(level).spawn(np.random.default_rng(seed)).floor_plan
            lintels = plan.boxes[np.isclose(plan.boxes[:, 5], 2.1)]
            assert len(lintels) == 1
            assert 0.95 - 1e-9 <= 2 * lintels[0, 3] <= widest + 1e-9


def test_a_net_leads_round_corners_and_through_a_door():
    plan = FloorPlan()
    plan.room(0.0, 0.0, 10.0, 4.0)
    plan.wall(5.0, 0.0, 5.0, 4.0, doors=[(2.0, 0.9)])
    net = walk_net(np.random.default_rng(0), plan, (0.0, 0.0, 10.0, 4.0), (1.0, 1.0))
    left = {k for k in range(len(net.places)) if net.places[k, 0] < 5.0}
    assert 0 < len(left) < len(net.places)
    through = [(a, int(b)) for a in left for b in net.links[a] if b >= 0 and int(b) not in left]
    assert through
    for a, b in through:
        (x0, y0), (x1, y1) = net.places[a, :2], net.places[b, :2]
        crossing_y = y0 + (5.0 - x0) / (x1 - x0) * (y1 - y0)
        assert abs(crossing_y - 2.0) < 0.45 - 0.3
