"""The planner that knows everybody's whole future: finds commands that bring the robot through one world (BENCHMARK).

What it finds it drives in the simulator before it is believed: a plan succeeds, exactly as it will when it is replayed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from densecavoid.foresight import lattice
from densecavoid.foresight.future import Future, foresee, solid_bodies, unheeding
from densecavoid.frames import Command, require
from densecavoid.scenarios.free_space import clearance_grid_m
from densecavoid.sim.config import SimConfig
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.people import LEFT_TRUNK, PARTS, RIGHT_TRUNK
from densecavoid.sim.spec import Scenario, WorldSpec
from densecavoid.sim.world import Simulator

HOLD_S = 0.4
"""For how long a command is held."""
MARGIN_M = 0.002
"""Beyond the collision distance: places are rounded to float32 where bodies are stored."""
RESOLUTIONS = ((0.2, 24, 4.0), (0.2, 24, np.inf), (0.1, 40, np.inf))
"""Sides of the cells of place (m), numbers of headings, and how far states may lie behind the foremost (m): one after
the other until a way is found."""
_BEYOND_M = 1.5
"""So far around everything that stands, start and goal, the robot may go."""
DENSITY_WITHIN_M, DENSITY_S = 1.5, 20.0
"""Of the straight way from start to goal, and of time: where and when people are counted."""
_BESIDE_M = 0.5
"""So far beside those who will appear the robot may be when they do."""


@dataclass(frozen=True)
class Plan:
    """Commands for one world, and how long they take."""

    commands: Float[np.ndarray, "K 2"]
    """Linear (m/s) and angular (rad/s) velocity, one row a control step."""
    time_s: float
    """Until the goal is reached; a whole number of control steps."""


@dataclass(frozen=True)
class Judgement:
    """What is known of one world before anybody drives in it."""

    plan: Plan | None
    """None: no way was found."""
    density_per_m2: float | None
    """People per m2 of free ground within 1.5 m of the straight line from start to goal, mean over the first 20 s; None
    where people appear suddenly."""


@dataclass(frozen=True)
class Terrain:
    """What stands still in one world, ready for searches with this goal."""

    ground: lattice.Ground
    goal: Float[np.ndarray, "2"]


def judge_worlds(scenario: Scenario, seeds: Sequence[int], config: SimConfig) -> list[Judgement]:
    """The quickest ways found through the worlds that (scenario, seed) draws, and how dense the crowd is there.

    A way may exist all the same where none is found: commands are held for .4 s, and of robots that are in one cell at
    once only one is followed on.

    Args:
        scenario: Its people must not react.
        seeds: One a world.
        config: Whose pace, motion model, robot and clock are kept, on ideal wheels.
    """
    config = unheeding(config)
    simulator = Simulator(scenario, 1, config)
    judgements = []
    for future, seed in zip(foresee(scenario, seeds, config), seeds, strict=True):
        spec = future.spec
        terrain = terrain_of(spec.floor_plan, spec, np.array(spec.goal))
        if spec.appearance is None:
            start, limit_s = np.array(spec.start_pose), spec.time_limit_s
            way = find_way(terrain, start, future.bodies, False, spec, config, limit_s)
            ways, density = [] if way is None else [way], density_per_m2(future, terrain, config)
        else:
            ways, density = _ways_before_they_appear(simulator, spec, terrain, seed), None
        plans = [plan for way in ways if (plan := _driven(simulator, seed, way)) is not None]
        judgements.append(Judgement(min(plans, key=lambda plan: plan.time_s, default=None), density))
    return judgements


def density_per_m2(future: Future, terrain: Terrain, config: SimConfig) -> float:
    """Mean number of people near the straight way of a world, by the free ground there (`Judgement`)."""
    ground, cell = terrain.ground, lattice.CELL_M
    start, goal = np.array(future.spec.start_pose[:2]), np.array(future.spec.goal)
    rows, columns = np.nonzero(ground.clearance > 0)
    centres = np.stack([ground.x0 + (rows + 0.5) * cell, ground.y0 + (columns + 0.5) * cell], axis=1)
    area_m2 = _is_near_line(centres, start, goal).sum() * cell**2
    shown = future.bodies[: round(DENSITY_S / config.physics_dt_s) : 10]
    shown = shown.reshape(len(shown), -1, PARTS - 1, 3)
    # The halves of the trunk lie on either side of the body's axis.
    there, centre = shown[:, :, LEFT_TRUNK, 2] > 0, shown[:, :, (LEFT_TRUNK, RIGHT_TRUNK), :2].mean(axis=2)
    people = (_is_near_line(centre.reshape(-1, 2), start, goal) & there.ravel()).sum() / max(len(shown), 1)
    return float(people / max(area_m2, cell**2))


def _is_near_line(
    points: Float[np.ndarray, "N 2"], start: Float[np.ndarray, "2"], goal: Float[np.ndarray, "2"]
) -> Bool[np.ndarray, "N"]:
    way = goal - start
    share = np.clip((points - start) @ way / (way @ way), 0.0, 1.0)
    return np.linalg.norm(points - start - share[:, None] * way, axis=1) < DENSITY_WITHIN_M


def _ways_before_they_appear(
    simulator: Simulator, spec: WorldSpec, onwards: Terrain, seed: int
) -> list[Float[np.ndarray, "K 2"]]:
    """Ways through a world in which people appear across the robot's way, which is empty until then.

    Where they stand along the corridor depends on where the robot is when they appear; it approaches straight or on one
    side of their line, and goes on from there among people who stand.
    """
    assert spec.appearance is not None
    config, start = simulator.config, np.array(spec.start_pose)
    y, radius = spec.crowd.pos[:, 1], spec.crowd.radius_m
    asides = [spec.goal[1], (y + radius).max() + _BESIDE_M, (y - radius).min() - _BESIDE_M]
    ahead = spec.appearance.trigger_distance_m + 2 * spec.goal_distance_m
    nobody, ways = np.zeros((0, 0, 3), np.float32), []
    for aside in asides:
        target = np.array([start[0] + ahead, aside])
        approach = find_way(
            terrain_of(spec.floor_plan, spec, target), start, nobody, False, spec, config, spec.time_limit_s
        )
        if approach is None:
            continue
        simulator.reset(np.array([seed]))
        taken = 0
        while taken < len(approach) and np.isnan(simulator.spawn_time_s[0]) and not simulator.done[0]:
            simulator.step(_command(approach[taken]))
            taken += 1
        if np.isnan(simulator.spawn_time_s[0]) or simulator.done[0]:
            continue
        bodies = solid_bodies(simulator, 0)[None].astype(np.float32)
        left_s = spec.time_limit_s - taken * config.control_dt_s
        rest = find_way(onwards, simulator.robot_pose[0].copy(), bodies, True, spec, config, left_s)
        if rest is not None:
            ways.append(np.concatenate([approach[:taken], rest]))
    return ways


def terrain_of(plan: FloorPlan, spec: WorldSpec, goal: Float[np.ndarray, "2"]) -> Terrain:
    """The distances that searches in a floor plan look up."""
    ends = np.array([spec.start_pose[:2], spec.goal, goal])
    low, high = ends.min(axis=0), ends.max(axis=0)
    boxes = plan.packed().boxes
    if len(boxes) > 0:
        reach = boxes[:, 4] + boxes[:, 5]
        low = np.minimum(low, (boxes[:, :2] - reach[:, None]).min(axis=0))
        high = np.maximum(high, (boxes[:, :2] + reach[:, None]).max(axis=0))
    low, high = low - _BEYOND_M, high + _BEYOND_M
    area = (float(low[0]), float(low[1]), float(high[0]), float(high[1]))
    need, cell = spec.collision_distance_m, lattice.CELL_M
    clearance = clearance_grid_m(plan, area, cell, need + 2 * cell).astype(np.float32)
    at = np.floor((goal - low) / cell).astype(int)
    to_goal = lattice.shortest_ways(clearance > need - cell, int(at[0]), int(at[1]), cell)
    return Terrain(lattice.Ground(area[0], area[1], clearance, to_goal.astype(np.float32)), goal)


def find_way(
    terrain: Terrain,
    start: Float[np.ndarray, "3"],
    bodies: Float[np.ndarray, "T N 3"],
    stay: bool,
    spec: WorldSpec,
    config: SimConfig,
    time_limit_s: float,
) -> Float[np.ndarray, "K 2"] | None:
    """Commands, one a control step, on the quickest way that the lattice has; None without one.

    Args:
        terrain: What stands still, and where to go.
        start: Pose.
        bodies: People's cylinders after each physics step (`Future.bodies`).
        stay: Whether they stay as they are in the last row.
        spec: Its collision and goal distances.
        config: Its robot and clock.
        time_limit_s: From the start.
    """
    hold = round(HOLD_S / config.control_dt_s)
    require(hold >= 1, "control_dt_s", config.control_dt_s, f"at most {HOLD_S} s")
    rules = lattice.Rules(
        collision_m=spec.collision_distance_m + MARGIN_M,
        goal_m=spec.goal_distance_m - MARGIN_M,
        max_linear=config.robot.max_linear_velocity,
        max_angular=config.robot.max_angular_velocity,
        dt_s=config.physics_dt_s,
        steps=hold * config.sub_steps,
        max_steps=math.floor(time_limit_s / config.physics_dt_s + 1e-9),
    )
    commands = lattice.COMMANDS * [rules.max_linear, rules.max_angular]
    bodies = np.ascontiguousarray(bodies, np.float32)
    for resolution in RESOLUTIONS:
        way, steps = lattice.search(start, terrain.goal, bodies, stay, terrain.ground, rules, commands, *resolution)
        if steps >= 0:
            return np.repeat(commands[way], hold, axis=0)[: math.ceil(steps / config.sub_steps)]
    return None


def _driven(simulator: Simulator, seed: int, commands: Float[np.ndarray, "K 2"]) -> Plan | None:
    """The plan, if it succeeds in the simulator."""
    # A command may travel as float32 (`frames.Command`).
    commands = commands.astype(np.float32).astype(np.float64)
    simulator.reset(np.array([seed]))
    driven = 0
    while driven < len(commands) and not simulator.done[0]:
        simulator.step(_command(commands[driven]))
        driven += 1
    return Plan(commands[:driven], float(simulator.time_s[0])) if simulator.succeeded[0] else None


def _command(velocities: Float[np.ndarray, "2"]) -> Command:
    return Command(velocities[:1].astype(np.float32), velocities[1:].astype(np.float32))
