"""The motion models against independent values: a public ORCA, a potential's slope, and what all of them promise."""

from __future__ import annotations

import math

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_worlds import MOTIONS, Given, crowd, go, simulate

from densecavoid.frames import Command
from densecavoid.scenarios import make_scenario
from densecavoid.scenarios.free_space import free_points
from densecavoid.sim.config import SimConfig
from densecavoid.sim.crowds import orca, social_force
from densecavoid.sim.crowds.neighbours import Scene, collect, find_things, look_up, make_scratch
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.people import ABSENT, TRAVERSING
from densecavoid.sim.spec import Crowd, WorldSpec
from densecavoid.sim.world import Simulator


def scene_with(pos, vel, radius, speed_limit, plan: FloorPlan | None = None) -> Scene:
    """People as the models see them, with a robot far away that nobody notices."""
    count, packed = len(pos), (plan or FloorPlan()).packed()
    return Scene(
        np.asarray(pos, float),
        np.asarray(vel, float),
        np.zeros(count),
        np.full(count, float(radius)),
        np.full(count, speed_limit / 1.3),
        np.full(count, TRAVERSING, np.int8),
        np.zeros(count, np.int8),
        packed.boxes,
        packed.cylinders,
        np.array([900.0, 0.0, 0.0, 0.0, 0.2]),
    )


@numba.njit
def orca_velocities(scene, intended, dt):
    scratch = make_scratch(len(intended))
    scratch.intended[:] = intended
    look_up(scene, scratch)
    find_things(scene, scratch, True)
    orca.choose_velocities(scene, scratch, dt)
    return scratch.velocity


@numba.njit
def everybody_near(scene, radius):
    scratch = make_scratch(len(scene.pos))
    look_up(scene, scratch)
    near = np.zeros((len(scene.pos), len(scene.pos)), np.bool_)
    for i in range(len(scene.pos)):
        for n in range(collect(i, scene.pos[i, 0], scene.pos[i, 1], scratch, radius)):
            near[i, scratch.near[n]] = True
    return near


@given(st.integers(0, 10_000), st.sampled_from([1, 7, 60, 300]), st.floats(0.1, 30.0), st.floats(0.3, 6.0))
@settings(max_examples=40, deadline=None)
def test_people_find_exactly_those_near_them(seed, count, side, radius):
    rng = np.random.default_rng(seed)
    pos = rng.uniform(0, [side, side * rng.uniform(0, 1)], (count, 2))
    scene = scene_with(pos, np.zeros((count, 2)), 0.25, 1.0)
    scene.behaviour[rng.random(count) < 0.2] = ABSENT
    there = scene.behaviour != ABSENT
    near = everybody_near(scene, radius)
    expected = np.hypot(*(pos[:, None] - pos[None]).transpose(2, 0, 1)) < radius
    np.fill_diagonal(expected, False)
    np.testing.assert_array_equal(near[there], (expected & there[None])[there])


@pytest.mark.parametrize("side", [1.2, 2.5, 6.0])
def test_orca_velocities_are_those_of_a_public_implementation(side):
    pyrvo = pytest.importorskip("pyrvo")
    rng = np.random.default_rng(int(10 * side))
    dt, radius, limit = 0.1, 0.3, 1.3
    for _ in range(40):
        count = int(rng.integers(2, 10))
        pos, vel, wish = (
            rng.uniform(0, side, (count, 2)),
            rng.normal(0, 0.7, (count, 2)),
            rng.normal(0, 0.8, (count, 2)),
        )
        theirs = pyrvo.RVOSimulator(
            dt, orca.SIGHT_M, orca.NEIGHBOURS, orca.HORIZON_S, orca.THING_HORIZON_S, radius, limit
        )
        for p, v, w in zip(pos.tolist(), vel.tolist(), wish.tolist(), strict=True):
            agent = theirs.add_agent(tuple(p))
            theirs.set_agent_velocity(agent, tuple(v))
            theirs.set_agent_pref_velocity(agent, tuple(w))
        theirs.do_step()
        expected = [theirs.get_agent_velocity(agent) for agent in range(count)]
        expected = np.array([(v.x, v.y) if hasattr(v, "x") else tuple(v) for v in expected])
        ours = orca_velocities(scene_with(pos, vel, radius, limit), wish, dt)
        np.testing.assert_allclose(ours, expected, atol=1e-3)


@given(st.integers(0, 10_000))
@settings(max_examples=60, deadline=None)
def test_orca_finds_the_allowed_velocity_nearest_to_the_wish(seed):
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 6))
    angle = rng.uniform(-3.1, 3.1, count)
    normal = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    planes = np.hstack([normal * rng.uniform(-1.2, 0.4, (count, 1)), normal])
    wish, best = rng.normal(0, 1, 2), np.empty(2)
    orca.nearest_velocity(planes, count, 0, 1.3, *wish, best)
    grid = np.stack(np.meshgrid(*[np.linspace(-1.3, 1.3, 521)] * 2), axis=-1).reshape(-1, 2)
    grid = grid[np.hypot(*grid.T) <= 1.3]
    beyond = ((planes[None, :, :2] - grid[:, None]) * planes[None, :, 2:]).sum(axis=2).max(axis=1)
    ours = ((planes[:, :2] - best) * planes[:, 2:]).sum(axis=1).max()
    assert math.hypot(*best) <= 1.3 + 1e-6
    if beyond.min() > 0.01:  # nothing is allowed: least beyond
        assert ours <= beyond.min() + 1e-6
    elif (beyond < 0).any():
        assert ours <= 1e-6
        assert math.dist(best, wish) <= np.hypot(*(grid[beyond <= 0] - wish).T).min() + 1e-6


def test_orca_people_walk_up_to_a_wall_as_a_public_implementation_does():
    pyrvo = pytest.importorskip("pyrvo")
    plan = FloorPlan()
    plan.box(5.05, 0.0, 0.1, 60.0)
    for x in (3.9, 4.4, 4.6):
        theirs = pyrvo.RVOSimulator(0.1, orca.SIGHT_M, 10, orca.HORIZON_S, orca.THING_HORIZON_S, 0.3, 1.3)
        theirs.add_obstacle([(5.0, -30.0), (5.1, -30.0), (5.1, 30.0), (5.0, 30.0)])
        theirs.process_obstacles()
        agent = theirs.add_agent((x, 0.0))
        theirs.set_agent_velocity(agent, (0.2, 0.1))
        theirs.set_agent_pref_velocity(agent, (1.0, 0.5))
        theirs.do_step()
        v = theirs.get_agent_velocity(agent)
        expected = (v.x, v.y) if hasattr(v, "x") else tuple(v)
        scene = scene_with([[x, 0.0]], [[0.2, 0.1]], 0.3, 1.3, plan)
        np.testing.assert_allclose(orca_velocities(scene, np.array([[1.0, 0.5]]), 0.1)[0], expected, atol=1e-3)


@given(st.floats(-2, 2), st.floats(-2, 2), st.floats(-2, 2), st.floats(-2, 2))
@settings(max_examples=50, deadline=None)
def test_social_force_is_the_slope_of_its_potential(x, y, step_x, step_y):
    if math.hypot(x, y) < 0.2 or math.hypot(x - step_x, y - step_y) < 0.2:
        return

    def potential(x, y):
        reach = math.hypot(x, y) + math.hypot(x - step_x, y - step_y)
        return 2.1 * math.exp(-0.5 * math.sqrt(max(reach**2 - step_x**2 - step_y**2, 0)) / 0.3)

    if math.hypot(x, y) + math.hypot(x - step_x, y - step_y) < math.hypot(step_x, step_y) + 0.05:
        return  # on the other's way itself the slope is not defined
    h = 1e-6
    slope_x = (potential(x + h, y) - potential(x - h, y)) / (2 * h)
    slope_y = (potential(x, y + h) - potential(x, y - h)) / (2 * h)
    np.testing.assert_allclose(
        social_force.ellipse_force(x, y, step_x, step_y), (-slope_x, -slope_y), rtol=1e-3, atol=1e-4
    )


@pytest.mark.parametrize("motion", MOTIONS)
def test_two_people_who_meet_head_on_pass_each_other(motion):
    sim = simulate(
        crowd([[0.0, 0.0], [8.0, 0.05]], [[20.0, 0.0], [-20.0, 0.0]]), config=SimConfig(threads=1, motion=motion)
    )
    closest = math.inf
    for _ in range(100):
        go(sim, 0.1)
        closest = min(closest, math.dist(*sim._state.pos[0]))
    assert sim._state.pos[0, 0, 0] > 8.0 and sim._state.pos[0, 1, 0] < 0.0
    assert closest > 0.4


@pytest.mark.parametrize("motion", MOTIONS)
def test_one_alone_walks_straight_at_the_speed_they_like(motion):
    sim = simulate(crowd([[0.0, 0.0]], [[90.0, 0.0]], speed=1.2), config=SimConfig(threads=1, motion=motion))
    go(sim, 5.0)
    np.testing.assert_allclose(sim._state.pos[0, 0], [6.0, 0.0], atol=1e-6)


@pytest.mark.parametrize("motion", MOTIONS)
def test_worlds_without_people_and_with_absent_ones_work(motion):
    config = SimConfig(threads=1, motion=motion)
    for people in (Crowd.nobody(), crowd([[0.0, 0.0], [1.0, 0.0]], [[0.0, 0.0], [1.0, 0.0]], behaviour=ABSENT)):
        sim = simulate(people, config=config)
        go(sim, 0.5)
        assert not sim.people().active.any() and not np.isnan(sim.sense().scan_m).any()


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("people", ["reactive", "mixed"])
def test_same_seed_same_bits_for_any_batch_threads_and_resume(motion, people):
    def crowded(rng: np.random.Generator) -> WorldSpec:
        count = int(rng.integers(20, 60))  # both ways of looking for neighbours
        plan = FloorPlan()
        plan.room(0.0, 0.0, 7.0, 7.0)
        everyone = crowd(
            free_points(rng, plan, (0.5, 0.5, 6.5, 6.5), count, 0.3, 0.52, (3.5, 3.5), 0.5),
            rng.uniform(0.5, 6.5, (count, 2)),
            rng.uniform(0.3, 1.5, count),
            group=rng.integers(-1, 8, count),
        )
        return WorldSpec("crowded", plan, (3.5, 3.5, 0.0), (900.0, 0.0), everyone, 1e6, collision_distance_m=1e-3)

    def course(batch: int, threads: int, resume: bool) -> np.ndarray:
        config = SimConfig(threads=threads, motion=motion, people=people)
        sim = Simulator(Given(crowded), batch, config)
        sim.reset(100 - np.arange(batch))
        for step in range(30):
            if resume and step == 15:
                saved, sim = sim.state_dict(), Simulator(Given(crowded), batch, config)
                sim.load_state_dict(saved)
            sim.step(Command(np.full(batch, 0.3), np.full(batch, 0.1)))
        state = sim._state
        there = state.behaviour[0] != ABSENT
        return np.column_stack([state.pos[0], state.vel[0], state.heading[0], state.phase[0]])[there]

    reference = course(1, 1, False)
    np.testing.assert_array_equal(reference, course(1, 1, True))
    np.testing.assert_array_equal(reference, course(5, 2, False))


@pytest.mark.parametrize("motion", ["social-force", "orca"])
def test_reactive_recorded_people_follow_their_way_with_any_model(motion, data_dir):
    scenario = make_scenario("hermes:bo-360-050-050:reactive", data_dir)
    sim = Simulator(scenario, 1, SimConfig(threads=1, motion=motion))
    sim.reset(np.array([3]))
    state, step = sim._state, 60
    go(sim, step * 0.1)
    replay = scenario.spawn(np.random.default_rng(3)).replay
    assert replay is not None
    recording = replay.recording
    person, rows = recording.at(int(state.recording_step[0]) + 2 * step)
    where = {int(p): row[:2] for p, row in zip(person, rows, strict=True)}
    there = np.flatnonzero(state.behaviour[0] != ABSENT)
    assert len(there) > 3
    astray = [math.dist(state.pos[0, i], where[int(state.person_id[0, i])]) for i in there]
    assert np.median(astray) < 1.5  # after 9 m of way
