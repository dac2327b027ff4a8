"""Promises of value fields: they are what dynamic programming gives, and following them leads to the goal."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from densecavoid.foresight import field_kernels as kernels
from densecavoid.foresight.future import foresee, unheeding
from densecavoid.foresight.value_field import FieldConfig, FieldStack, ValueField, value_field
from densecavoid.frames import Command
from densecavoid.scenarios import make_scenario
from densecavoid.sim.config import SimConfig
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.spec import WorldSpec
from densecavoid.sim.world import Simulator

SIM = SimConfig(threads=1)
NOBODY = np.zeros((0, 0, 3), np.float32)


def alone(field: ValueField, config: FieldConfig) -> FieldStack:
    stack = FieldStack(1, field.values.size, config)
    stack.put(0, field)
    return stack


def value(stack: FieldStack, x: float, y: float, yaw: float, time_s: float = 0.0) -> float:
    return float(stack.of_poses(np.zeros(1, np.int64), np.array([[x, y, yaw]]), np.array([time_s]))[0])


def test_in_an_empty_world_a_place_is_worth_the_time_to_the_goal() -> None:
    a_moment = 0.97
    config = FieldConfig(slip=0.0, discount=a_moment ** (SIM.control_dt_s / FieldConfig().hold_s))
    spec = WorldSpec("empty", FloorPlan(), (0.0, 0.0, 0.0), (5.0, 0.0))
    stack = alone(value_field(spec, NOBODY, SIM, config), config)
    for distance_m in (1.5, 3.0, 5.0):
        moments = (distance_m - spec.goal_distance_m) / (SIM.robot.max_linear_velocity * config.hold_s)
        # A moment counts as a whole one, and cells near the goal's edge are partly in it.
        low, high = a_moment ** (moments + 1.5), a_moment ** (moments - 1.0)
        assert low < value(stack, 5.0 - distance_m, 0.0, 0.0) < high
    # To turn round first takes pi / .4 rad/s of .4 s moments; turning the other way takes as long.
    turned = value(stack, 2.0, 0.0, math.pi)
    assert turned < value(stack, 2.0, 0.0, 0.0) * a_moment**12
    assert value(stack, 2.0, 0.5, 1.2) == pytest.approx(value(stack, 2.0, -0.5, -1.2), abs=0.01)


def test_one_step_back_is_what_interpolation_by_scipy_gives() -> None:
    rng = np.random.default_rng(0)
    headings, commands, frame = 6, 4, kernels.FRAME
    following = rng.uniform(-0.5, 1.0, (headings, 9 + 2 * frame, 7 + 2 * frame)).astype(np.float32)
    steps = np.concatenate(
        [rng.uniform(-4.0, 4.0, (headings, commands, 2)), rng.integers(headings, size=(headings, commands, 1))], axis=2
    )
    best, total = np.zeros_like(following), np.zeros_like(following)
    kernels.back_up(following, best, total, steps)
    i, j = np.meshgrid(np.arange(frame, 9 + frame), np.arange(frame, 7 + frame), indexing="ij")
    for h in range(headings):
        led = [
            map_coordinates(following[int(later)], [i + ahead_i, j + ahead_j], order=1)
            for ahead_i, ahead_j, later in steps[h]
        ]
        inside = (h, slice(frame, -frame), slice(frame, -frame))
        np.testing.assert_allclose(best[inside], np.max(led, axis=0), atol=1e-5)
        np.testing.assert_allclose(total[inside], np.sum(led, axis=0), atol=1e-5)


def test_where_a_person_will_be_is_worth_a_collision_then_and_not_before() -> None:
    config = FieldConfig()
    plan = FloorPlan()
    plan.room(0.0, 0.0, 6.0, 6.0)
    spec = WorldSpec("room", plan, (1.0, 3.0, 0.0), (5.0, 3.0))
    bodies = np.zeros((400, 1, 3), np.float32)
    bodies[:, 0, 0], bodies[:, 0, 2] = 3.0, 0.2
    bodies[:, 0, 1] = np.linspace(0.5, 5.5, 400)  # .25 m/s across
    stack = alone(value_field(spec, bodies, SIM, config), config)
    for time_s in (2.0, 10.0, 18.0):
        row = round(time_s / SIM.physics_dt_s) - 1
        assert value(stack, 3.0, float(bodies[row, 0, 1]), 0.0, time_s) == pytest.approx(config.collision, abs=0.02)
    assert value(stack, 3.0, 5.0, 0.0, 0.0) > 0.5
    assert value(stack, 3.0, 1.0, 0.0, 12.0) > 0.5


def test_the_goal_must_be_free() -> None:
    plan = FloorPlan()
    plan.room(0.0, 0.0, 6.0, 6.0)
    plan.box(5.0, 3.0, 1.5, 1.5, 0.0, 0.0, 1.0)
    with pytest.raises(ValueError, match="the goal of room"):
        value_field(WorldSpec("room", plan, (1.0, 3.0, 0.0), (5.0, 3.0)), NOBODY, SIM)


@pytest.mark.parametrize(("scenario", "at_least"), [("dense-static", 11), ("dense-ped", 11), ("random-sparse-ped", 11)])
def test_who_follows_the_best_commands_arrives(scenario: str, at_least: int) -> None:
    """Of 12 worlds. Grids are coarser than the planner's, which finds ways through nearly all."""
    config, seeds = FieldConfig(), np.arange(12)
    worlds = make_scenario(scenario)
    futures = foresee(worlds, seeds.tolist(), SIM)
    stack = FieldStack(12, 400_000_000, config)
    for slot, future in enumerate(futures):
        stack.put(slot, value_field(future.spec, future.bodies, SIM, config))
    commands = np.array([(v, w) for v in (0.0, 0.25, 0.5, 0.75, 1.0) for w in (-0.4, -0.2, 0.0, 0.2, 0.4)])
    simulator = Simulator(worlds, 12, unheeding(SIM))
    simulator.reset(seeds)
    over, arrived = np.zeros(12, np.bool_), np.zeros(12, np.bool_)
    while not over.all():
        worth = stack.of_commands(seeds, simulator.robot_pose, simulator.time_s, commands)
        v, w = commands[worth.argmax(axis=1)].T
        simulator.step(Command(v.astype(np.float32), w.astype(np.float32)))
        arrived |= simulator.succeeded & ~over
        over |= simulator.done
    assert arrived.sum() >= at_least


def test_starts_are_free_and_worth_it() -> None:
    worlds = make_scenario("dense-static")
    (future,) = foresee(worlds, [3], SIM)
    field = value_field(future.spec, future.bodies, SIM)
    poses = field.free_poses(np.random.default_rng(0), 20, 0.2)
    assert len(poses) == 20
    stack = alone(field, FieldConfig())
    moved = [replace(future.spec, start_pose=pose) for pose in poses]
    for spec in moved:
        assert value(stack, *spec.start_pose) >= 0.19

    class Given:
        name = "given"

        def spawn(self, rng: np.random.Generator) -> WorldSpec:
            return moved[int(rng.integers(len(moved)))]

    simulator = Simulator(Given(), 20, SIM)
    simulator.reset(np.arange(20))
    assert (simulator.clearance_m > 0.3).all() and not simulator.done.any()


def test_a_stack_replaces_what_it_held_and_refuses_what_does_not_fit() -> None:
    config, rng = FieldConfig(), np.random.default_rng(0)

    def constant(worth: float, size: int) -> ValueField:
        values = np.full((1, 4, size, size), worth * kernels.STEPS_OF_SCALE, np.int16)
        return ValueField(values, np.array([0.0, 0.0, 1.0]))

    stack = FieldStack(3, 4 * (36 + 64 + 100), config)
    held = {0: 0.1, 1: 0.2, 2: 0.3}
    for slot, size in enumerate((6, 8, 10)):
        stack.put(slot, constant(held[slot], size))
    for k in range(40):
        slot = int(rng.integers(3))
        held[slot] = 0.01 * k
        stack.put(slot, constant(held[slot], 5))
        for each, worth in held.items():
            at = stack.of_poses(np.array([each]), np.array([[2.0, 2.0, 1.0]]), np.zeros(1))
            assert at[0] == pytest.approx(worth, abs=1e-4)
    with pytest.raises(MemoryError, match="no room for 4,000,000"):
        stack.put(0, constant(0.0, 1000))
