"""The simulator's promises: commands become motion, episodes end as BENCHMARK says, same seed same bits."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from densecavoid.frames import Command, LidarConfig, RobotConfig
from densecavoid.scenarios import make_scenario, names
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.people import STANDING, TRAVERSING
from densecavoid.sim.spec import Crowd, WorldSpec
from densecavoid.sim.world import SimConfig, Simulator


class OneWorld:
    name = "one"

    def __init__(self, **kwargs) -> None:
        defaults = {"scenario": "one", "floor_plan": FloorPlan(), "start_pose": (0.0, 0.0, 0.0), "goal": (50.0, 0.0)}
        self.spec = WorldSpec(**{**defaults, **kwargs})

    def spawn(self, rng: np.random.Generator) -> WorldSpec:
        return self.spec


def simulate(config: SimConfig | None = None, **kwargs) -> Simulator:
    sim = Simulator(OneWorld(**kwargs), 1, config)
    sim.reset(np.zeros(1, np.int64))
    return sim


def drive(sim: Simulator, linear: float, angular: float = 0.0, steps: int = 1) -> None:
    for _ in range(steps):
        sim.step(Command(np.full(sim.num_worlds, linear), np.full(sim.num_worlds, angular)))


@given(st.floats(0.0, 1.0), st.floats(-0.4, 0.4))
@settings(max_examples=25, deadline=None)
def test_motion_is_the_exact_arc(linear, angular):
    sim = simulate()
    drive(sim, linear, angular, steps=30)
    x = y = yaw = 0.0
    for _ in range(30_000):  # fine midpoint steps
        yaw += angular * 0.5e-4
        x, y = x + linear * 1e-4 * math.cos(yaw), y + linear * 1e-4 * math.sin(yaw)
        yaw += angular * 0.5e-4
    np.testing.assert_allclose(sim.robot_pose[0], [x, y, yaw], atol=1e-6)


def test_commands_are_limited_to_the_robots_speeds():
    sim = simulate()
    drive(sim, 7.0, -3.0)
    np.testing.assert_allclose(sim.robot_velocity[0], [1.0, -0.4])
    drive(sim, -1.0)
    assert sim.robot_velocity[0, 0] == 0.0


def test_dynamic_robot_obeys_one_step_late_and_within_its_acceleration():
    sim = simulate(SimConfig(dynamics="dynamic"))
    speeds = []
    for _ in range(12):
        drive(sim, 1.0)
        speeds.append(sim.robot_velocity[0, 0])
    np.testing.assert_allclose(speeds, [0.0, *np.arange(1, 11) / 10, 1.0], atol=1e-9)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_command_that_is_not_finite_is_refused(bad):
    sim = simulate()
    with pytest.raises(ValueError, match="finite"):
        drive(sim, bad)
    with pytest.raises(ValueError, match="finite"):
        drive(sim, 0.1, bad)


def test_collision_is_a_surface_within_30_cm_of_the_centre():
    plan = FloorPlan()
    plan.box(2.0, 0.0, 1.0, 4.0)  # face at x = 1.5
    sim = simulate(floor_plan=plan)
    drive(sim, 1.0, steps=11)  # x = 1.1, .4 m away
    assert not sim.collided[0]
    assert sim.clearance_m[0] == pytest.approx(0.4, abs=1e-6)
    drive(sim, 1.0, steps=2)
    assert sim.collided[0] and sim.done[0] and not sim.succeeded[0]
    assert sim.collided_person[0] == -1 and not sim.fault[0]


def test_table_top_can_be_hit_and_a_lamp_cannot():
    for z_min, hit in ((0.70, True), (0.90, False)):
        plan = FloorPlan()
        plan.box(1.0, 0.0, 0.5, 2.0, z_min=z_min, z_max=z_min + 0.04)
        sim = simulate(floor_plan=plan)
        drive(sim, 1.0, steps=8)
        assert bool(sim.collided[0]) == hit


def one_person(x: float, speed: float, behaviour: int, goal_x: float = -20.0) -> Crowd:
    one = np.ones(1)
    return Crowd(
        np.array([[x, 0.0]]), np.array([[goal_x, 0.0]]), speed * one, 0.25 * one, 1.7 * one, np.array([behaviour])
    )


def test_driving_into_a_standing_person_is_at_fault():
    sim = simulate(crowd=one_person(1.5, 0.5, STANDING))
    drive(sim, 1.0, steps=11)  # x = 1.1; the body is half of .28 m deep
    assert sim.collided[0] and sim.collided_person[0] == 0 and sim.fault[0]
    assert sim.clearance_people_m[0] == pytest.approx(0.30, abs=0.051)


def test_being_walked_into_while_standing_is_not_at_fault():
    sim = simulate(crowd=one_person(2.0, 1.0, TRAVERSING))
    drive(sim, 0.0, steps=18)
    assert sim.collided[0] and sim.collided_person[0] == 0 and not sim.fault[0]


def test_success_is_the_centre_within_30_cm_of_the_goal():
    sim = simulate(goal=(1.05, 0.0))
    drive(sim, 1.0, steps=7)
    assert not sim.succeeded[0]
    drive(sim, 1.0)
    assert sim.succeeded[0] and sim.done[0] and not sim.timed_out[0]


def test_time_limit_ends_an_episode_that_goes_on():
    sim = simulate(time_limit_s=1.0)
    drive(sim, 0.0, steps=9)
    assert not sim.done[0]
    drive(sim, 0.0)
    assert sim.timed_out[0] and sim.done[0] and not sim.collided[0] and not sim.succeeded[0]


def random_commands(seed: int, batch: int) -> Command:
    rng = np.random.default_rng(seed)
    v, w = rng.uniform(0, 1), rng.uniform(-0.4, 0.4)
    return Command(np.full(batch, v), np.full(batch, w))


@pytest.mark.parametrize("name", ["random-sparse-ped", "dense-ped", "dense-static"])
def test_same_seed_same_bits_for_any_batch_and_threads(name):
    def course(batch: int, threads: int) -> tuple[np.ndarray, ...]:
        sim = Simulator(make_scenario(name), batch, SimConfig(threads=threads))
        sim.reset(100 - np.arange(batch))  # the last world always has another number of boxes around it
        for step in range(20):
            sim.step(random_commands(step, batch))
        frame, people = sim.sense(), sim.people()
        present = people.active[0]
        return frame.scan_m[0], frame.depth_m[0], sim.robot_pose[0], people.pos_w[0][present]

    reference = course(1, 1)
    for batch, threads in ((3, 1), (8, 2)):
        for a, b in zip(reference, course(batch, threads), strict=True):
            np.testing.assert_array_equal(a, b)


def test_resetting_some_worlds_leaves_the_others_alone():
    sim = Simulator(make_scenario("dense-ped"), 3)
    sim.reset(np.array([1, 2, 3]))
    drive(sim, 0.5, steps=5)
    before = sim.robot_pose.copy(), sim.people().pos_w.copy()
    sim.reset(np.array([9, 9, 9]), np.array([False, True, False]))
    np.testing.assert_array_equal(sim.robot_pose[[0, 2]], before[0][[0, 2]])
    np.testing.assert_array_equal(sim.people().pos_w[[0, 2]], before[1][[0, 2]])
    assert sim.time_s[1] == 0.0 and sim.time_s[0] == pytest.approx(0.5)


def test_a_saved_simulator_goes_on_with_the_same_bits():
    first, second = (Simulator(make_scenario("random-sparse-ped"), 2) for _ in range(2))
    first.reset(np.array([1, 2]))
    drive(first, 0.3, 0.1, steps=5)
    second.load_state_dict(first.state_dict())
    for sim in (first, second):
        drive(sim, 0.3, -0.2, steps=10)
    np.testing.assert_array_equal(first.people().pos_w, second.people().pos_w)
    np.testing.assert_array_equal(first.sense().depth_m, second.sense().depth_m)


@pytest.mark.parametrize("name", names())
def test_lidar_and_collision_clearance_see_the_same_geometry(name):
    """In a world without overhead or low things the nearest lidar range is the clearance at the scanner's height."""
    sim = Simulator(make_scenario(name), 4, SimConfig(lidar=LidarConfig(num_rays=2048, fov_rad=2 * math.pi)))
    sim.reset(np.arange(4) + 50)
    drive(sim, 0.4, 0.2, steps=5)
    nearest_ray = sim.sense().scan_m.min(axis=1)
    for b in range(4):
        x, y = sim.robot_pose[b, :2]
        plan = sim.floor_plan(b)
        at_scan_height = [
            row
            for row, material in zip(plan.boxes, plan.box_materials, strict=True)
            if row[5] <= 0.26 <= row[6] and material != "glass"  # which a lidar may look through
        ]
        distance = math.inf
        for bx, by, yaw, hl, hw, *_ in at_scan_height:
            along = math.cos(yaw) * (x - bx) + math.sin(yaw) * (y - by)
            across = math.cos(yaw) * (y - by) - math.sin(yaw) * (x - bx)
            distance = min(distance, math.hypot(max(abs(along) - hl, 0), max(abs(across) - hw, 0)))
        for cx, cy, r, z_min, z_max in plan.cylinders:
            if z_min <= 0.26 <= z_max:
                distance = min(distance, math.hypot(x - cx, y - cy) - r)
        people = sim.people()
        legs_at_most = math.inf
        for i in np.flatnonzero(people.active[b]):
            legs_at_most = min(legs_at_most, math.hypot(*(people.pos_w[b, i] - (x, y))) + people.radius_m[b, i])
        if nearest_ray[b] < min(legs_at_most, 4.0) - 0.6 or distance < 4.0:
            assert nearest_ray[b] <= distance + 0.01  # nothing that can be hit is invisible
        # and nothing that is seen is farther away than what can be hit
        assert sim.nearest_surface_m(b, np.array([[x, y]]))[0] <= nearest_ray[b] + 1e-4


@given(st.integers(0, 10_000))
@settings(max_examples=15, deadline=None)
def test_people_neither_overlap_for_long_nor_enter_walls(seed):
    sim = Simulator(make_scenario("random-sparse-ped"), 4)
    sim.reset(seed * 10 + np.arange(4))
    for _ in range(80):
        drive(sim, 0.0)
    people, heading = sim.people(), sim._state.heading
    for b in range(4):
        pos, radius = people.pos_w[b], people.radius_m[b]
        # Bodies are as wide as 2 radius across the heading and .55 of that deep: points along the shoulders.
        along = np.linspace(-0.45, 0.45, 31)[None, :, None] * radius[:, None, None]
        across = np.stack([-np.sin(heading[b]), np.cos(heading[b])], axis=1)[:, None]
        shoulders = pos[:, None] + along * across  # [P, 31, 2]
        apart = np.hypot(*(shoulders[:, None, :, None] - shoulders[None, :, None]).transpose(4, 0, 1, 2, 3))
        gap = apart.min(axis=(2, 3)) - 0.55 * (radius[:, None] + radius[None])
        gap[np.diag_indices(len(pos))] = 1.0
        assert gap.min() > -0.05
        assert (pos - radius[:, None] > -0.02).all() and (pos + radius[:, None] < 8.02).all()


@pytest.mark.parametrize("band", [(0.5, 1.0), (1.0, 1.5), (1.5, 2.0)])
def test_people_appear_at_the_asked_distance_once_the_robot_has_come_three_metres(band):
    sim = Simulator(make_scenario(f"robot-freezing:{band[0]}-{band[1]}"), 16)
    sim.reset(np.arange(16))
    while np.isnan(sim.spawn_time_s).any():
        assert (sim.people().active.any(axis=1) == ~np.isnan(sim.spawn_time_s)).all()
        drive(sim, 1.0)
        just = np.abs(sim.spawn_time_s - sim.time_s) < 0.11
        people = sim.people()
        for b in np.flatnonzero(just):
            came = np.hypot(*(sim.robot_pose[b, :2] - sim.start_pose[b, :2]))
            assert 2.99 <= came <= 3.11
            parts = sim.body_cylinders(int(b))[people.active[b]]
            gap = np.hypot(*(parts[..., :2] - sim.robot_pose[b, :2]).transpose(2, 0, 1)) - parts[..., 2]
            assert band[0] - 0.11 <= gap.min() <= band[1] + 0.01  # the robot may have moved on by one step
            free_left = 2.0 - (people.pos_w[b, :, 1] + people.radius_m[b])[people.active[b]].max()
            free_right = 2.0 + (people.pos_w[b, :, 1] - people.radius_m[b])[people.active[b]].min()
            assert max(free_left, free_right) >= 1.0 - 1e-6
            assert people.active[b].sum() in (3, 4)
        assert sim.time_s[0] < 10


def test_bad_configuration_names_the_value():
    with pytest.raises(ValueError, match=r"physics_dt_s is 0\.2"):
        SimConfig(physics_dt_s=0.2)
    with pytest.raises(ValueError, match="radius_m is -1"):
        RobotConfig(radius_m=-1)
    with pytest.raises(ValueError, match="num_worlds is 0"):
        Simulator(make_scenario("dense-ped"), 0)


@pytest.mark.parametrize("name", names())
def test_a_world_fits_in_64_kib(name):
    sim = Simulator(make_scenario(name), 2)
    sim.reset(np.arange(2))
    assert sim.bytes_per_world <= 64 * 1024
    sensed = sim.sense()
    assert sim.bytes_per_world >= (sensed.scan_m.nbytes + sensed.depth_m.nbytes) // 2
