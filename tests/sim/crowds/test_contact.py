"""Bodies that touch: the gap between two outlines is the true one, and nobody stays in anybody or anything."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_worlds import MOTIONS, Given, crowd, go, simulate

from densecavoid.frames import Command
from densecavoid.sim.config import SimConfig
from densecavoid.sim.crowds.contact import stadium_gap
from densecavoid.sim.crowds.neighbours import shoulder_line
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.people import STANDING, TRAVERSING, WANDERING, half_depth
from densecavoid.sim.spec import WorldSpec
from densecavoid.sim.world import Simulator

ANGLE = st.floats(-4.0, 4.0)
RADIUS = st.floats(0.19, 0.33)


def gap_of(off, heading_a, radius_a, heading_b, radius_b):
    line_a, line_b = shoulder_line(heading_a, radius_a), shoulder_line(heading_b, radius_b)
    return stadium_gap(*off, *line_a, *line_b, half_depth(radius_a) + half_depth(radius_b))


def segment(centre, heading, radius, count=401):
    """Points along the line across somebody's heading that their body is thickened from."""
    half = radius - 0.55 * radius
    return np.asarray(centre) + np.linspace(-half, half, count)[:, None] * [-math.sin(heading), math.cos(heading)]


@given(st.tuples(st.floats(-0.9, 0.9), st.floats(-0.9, 0.9)), ANGLE, RADIUS, ANGLE, RADIUS)
@settings(max_examples=200, deadline=None)
def test_the_gap_between_two_bodies_is_that_of_their_outlines(off, heading_a, radius_a, heading_b, radius_b):
    gap, x, y = gap_of(off, heading_a, radius_a, heading_b, radius_b)
    points_a, points_b = segment(off, heading_a, radius_a), segment((0, 0), heading_b, radius_b)
    apart = np.hypot(*(points_a[:, None] - points_b[None]).transpose(2, 0, 1)).min()
    assert math.hypot(x, y) == pytest.approx(1.0, abs=1e-9)
    if apart > 5e-3:  # segments that cross have no distance to compare with
        assert gap == pytest.approx(apart - 0.55 * (radius_a + radius_b), abs=3e-3)
    # Whoever is moved along the normal by the overlap no longer overlaps.
    if gap < 0:
        again, _, _ = gap_of((off[0] - gap * x, off[1] - gap * y), heading_a, radius_a, heading_b, radius_b)
        assert again > gap - 1e-9 and (again > -1e-6 or apart < 5e-3)


def test_people_stand_closer_back_to_front_than_side_by_side():
    assert gap_of((0.275, 0.0), 0.0, 0.25, 0.0, 0.25)[0] == pytest.approx(0.0, abs=1e-9)
    assert gap_of((0.0, 0.5), 0.0, 0.25, 0.0, 0.25)[0] == pytest.approx(0.0, abs=1e-9)


def test_who_stands_does_not_give_way_and_who_walks_does():
    sim = simulate(crowd([[0.0, 0.0], [1.1, 0.2]], [[0.0, 0.0], [9.0, 0.2]], behaviour=[STANDING, TRAVERSING]))
    sim._state.pos[0, 1] = 0.1, 0.2  # a world that begins so is refused
    go(sim, 0.5)
    np.testing.assert_array_equal(sim.people().pos_w[0, 0], [0.0, 0.0])
    state = sim._state
    gap, _, _ = gap_of(state.pos[0, 1], state.heading[0, 1], 0.25, state.heading[0, 0], 0.25)
    assert gap > -0.005


def test_two_whom_walls_hold_turn_their_shoulders_past_each_other():
    """Side by side they need 1 m, and have .9."""
    plan = FloorPlan()
    for y in (-0.05, 0.95):
        plan.wall(-5.0, y, 20.0, y)
    sim = simulate(crowd([[0.0, 0.25], [3.0, 0.65]], [[15.0, 0.45], [15.0, 0.45]]), plan)
    state = sim._state
    state.pos[0, 1] = 0.0, 0.65  # a world that begins so is refused
    go(sim, 0.1)
    assert gap_of(state.pos[0, 1] - state.pos[0, 0], state.heading[0, 1], 0.25, state.heading[0, 0], 0.25)[0] > -0.005
    assert depth_inside(plan, state.pos[0], np.full(2, 0.25)).max() < 0.01


def depth_inside(plan: FloorPlan, pos, radius) -> np.ndarray:
    """How deep discs are in things, by plain formulas; positive inside."""
    deepest = np.full(len(pos), -np.inf)
    for x, y, yaw, half_length, half_width, *_ in plan.boxes:
        along = np.abs(math.cos(yaw) * (pos[:, 0] - x) + math.sin(yaw) * (pos[:, 1] - y)) - half_length
        across = np.abs(math.cos(yaw) * (pos[:, 1] - y) - math.sin(yaw) * (pos[:, 0] - x)) - half_width
        outside = np.hypot(np.maximum(along, 0), np.maximum(across, 0))
        distance = np.where(outside > 0, outside, np.maximum(along, across))
        deepest = np.maximum(deepest, radius - distance)
    for x, y, r, *_ in plan.cylinders:
        deepest = np.maximum(deepest, radius - (np.hypot(pos[:, 0] - x, pos[:, 1] - y) - r))
    return deepest


def hall(rng: np.random.Generator, density: float) -> WorldSpec:
    """A room with a wall that has a door, boxes and pillars, and people everywhere in it."""
    plan, side = FloorPlan(), 5.0
    plan.room(0.0, 0.0, side, side)
    door = rng.uniform(1.5, 3.5)
    plan.wall(0.0, 2.5, door - 0.6, 2.5)
    plan.wall(door + 0.6, 2.5, side, 2.5)
    for _ in range(2):
        x, y, x2, y2 = rng.uniform(0.8, side - 0.8, 4).tolist()
        length, width = rng.uniform(0.1, 0.6, 2).tolist()
        plan.box(x, y, length, width, rng.uniform(0, 3))
        plan.pillar(x2, y2, rng.uniform(0.05, 0.3))
    radius, pos = rng.uniform(0.19, 0.33, 400), np.zeros((0, 2))
    goal, heading = rng.uniform(0.4, side - 0.4, (400, 2)), np.zeros(400)
    for _ in range(4000):
        place, k = rng.uniform(0.3, side - 0.3, (1, 2)), len(pos)
        heading[k] = math.atan2(*(goal[k] - place[0])[::-1])
        near = np.flatnonzero(np.hypot(*(pos - place).T) < 0.7)
        if depth_inside(plan, place, radius[k])[0] < 0 and all(
            gap_of(place[0] - pos[j], heading[k], radius[k], heading[j], radius[j])[0] > 0 for j in near
        ):
            pos = np.vstack([pos, place])
        if len(pos) >= density * side * side:
            break
    # Who stands has room around: nobody starts wedged between those who do not give way.
    apart = np.hypot(*(pos[:, None] - pos[None]).transpose(2, 0, 1)) + 9.0 * np.eye(len(pos))
    kind = np.where((rng.random(len(pos)) < 0.3) & (apart.min(axis=1) > 0.62), STANDING, WANDERING)
    people = crowd(
        pos,
        goal[: len(pos)],
        rng.uniform(0.2, 1.5, len(pos)),
        kind,
        radius[: len(pos)],
        wander_area=(0.4, 0.4, side - 0.4, side - 0.4),
        changes_of_mind_per_s=0.1,
    )
    return WorldSpec("hall", plan, (-500.0, 0.0, 0.0), (900.0, 0.0), people, time_limit_s=1e6)


def crossings(plan: FloorPlan, before, after) -> np.ndarray:
    """Whether each went through a box from one side to another (the middle of the step is inside it)."""
    share = np.linspace(0, 1, 9)[:, None, None]
    way = before[None] + share * (after - before)[None]
    return np.array([depth_inside(plan, points, np.zeros(len(points))) for points in way]).max(axis=0) > 0


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("density", [0.8, 2.5])
@given(st.integers(0, 10_000))
@settings(max_examples=6, deadline=None)
def test_nobody_passes_a_wall_or_stays_in_anything_or_anybody(motion, density, seed):
    config = SimConfig(control_dt_s=0.05, threads=1, motion=motion)
    sim = Simulator(Given(lambda rng: hall(rng, density)), 1, config)
    sim.reset(np.array([seed]))
    state, plan, count = sim._state, sim.floor_plan(0), sim._state.pos.shape[1]
    overlapping_s = np.zeros((count, count))
    before = state.pos[0].copy()
    for _ in range(160):
        sim.step(Command(np.zeros(1), np.zeros(1)))
        pos, heading, radius = state.pos[0], state.heading[0], state.radius[0]
        assert np.isfinite(pos).all() and np.isfinite(state.vel[0]).all() and np.isfinite(heading).all()
        assert not crossings(plan, before, pos).any()
        walks = state.behaviour[0] != STANDING
        assert depth_inside(plan, pos, radius)[walks].max(initial=-1.0) < 0.01
        before = pos.copy()
        near = np.argwhere(np.triu(np.hypot(*(pos[:, None] - pos[None]).transpose(2, 0, 1)) < 0.66, 1))
        deep = np.zeros((count, count), bool)
        for i, j in near:
            gap = gap_of(pos[i] - pos[j], heading[i], radius[i], heading[j], radius[j])[0]
            deep[i, j] = gap < -0.02 and (walks[i] or walks[j])
        overlapping_s = np.where(deep, overlapping_s + 0.05, 0.0)
        assert overlapping_s.max() <= 0.5
