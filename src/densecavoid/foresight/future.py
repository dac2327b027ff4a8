"""Everybody's whole future: where each body will be at every instant of an episode, when nobody heeds the robot.

It is found by letting the world run with the robot far away. People who react to the robot have no future of their own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Float32

from densecavoid.frames import Command, require
from densecavoid.sim.config import SimConfig
from densecavoid.sim.geometry import CYL_RADIUS, CYL_X, CYL_Y, CYL_Z_MIN
from densecavoid.sim.spec import Scenario, WorldSpec
from densecavoid.sim.world import Simulator

_FAR_M = 1000.0
"""So far from everything the robot waits while the world runs without it."""


@dataclass(frozen=True)
class Future:
    """One world, and what its people will do."""

    spec: WorldSpec
    bodies: Float32[np.ndarray, "T N 3"]
    """x, y and radius of every cylinder that the robot could hit, after each physics step; radius 0: not there."""


@dataclass(frozen=True)
class Elsewhere:
    """The worlds of a scenario with the robot far away from them: where people walk when nobody disturbs them."""

    scenario: Scenario

    @property
    def name(self) -> str:
        return self.scenario.name

    def spawn(self, rng: np.random.Generator) -> WorldSpec:
        spec = self.scenario.spawn(rng)
        return replace(spec, start_pose=(_FAR_M, _FAR_M, 0.0), goal=(_FAR_M + 10.0, _FAR_M))


def unheeding(config: SimConfig) -> SimConfig:
    """The same people, who do not notice the robot, on ideal wheels; what a world is judged by (BENCHMARK)."""
    return replace(config, people="scripted", dynamics="ideal", sensors="clean")


def foresee(scenario: Scenario, seeds: Sequence[int], config: SimConfig) -> list[Future]:
    """The future of the worlds that (scenario, seed) draws.

    People who appear when the robot comes near (`WorldSpec.appearance`) are not in it: when and where depends on the
    robot's way.

    Args:
        scenario: Its people must not react.
        seeds: One a world; all run side by side.
        config: Whose pace, motion model and physics step are kept; `unheeding` is applied.
    """
    require(len(seeds) > 0, "seeds", list(seeds), "at least one")
    # One control step a physics step: nothing is commanded, and every instant can be looked at.
    config = replace(unheeding(config), control_dt_s=config.physics_dt_s)
    specs = [scenario.spawn(np.random.default_rng(int(seed))) for seed in seeds]
    for spec in specs:
        require(spec.replay is None or not spec.replay.reactive, "people of", spec.scenario, "people who do not react")
    simulator = Simulator(Elsewhere(scenario), len(seeds), config)
    simulator.reset(np.asarray(seeds, np.int64))
    steps = round(max(spec.time_limit_s for spec in specs) / config.physics_dt_s)
    first = solid_bodies(simulator, 0)
    bodies = np.zeros((len(seeds), steps, len(first), 3), np.float32)
    if len(first) > 0:
        nothing = np.zeros(len(seeds), np.float32)
        for k in range(steps):
            simulator.step(Command(nothing, nothing))
            for b in range(len(seeds)):
                bodies[b, k] = solid_bodies(simulator, b)
    return [Future(spec, bodies[b]) for b, spec in enumerate(specs)]


def solid_bodies(simulator: Simulator, b: int) -> Float[np.ndarray, "N 3"]:
    """x, y and radius of people's cylinders in world b that begin below the robot's top."""
    cylinders = simulator.body_cylinders(b)
    # The head comes last of a person's parts, and alone is above the robot: `people.place_body`.
    solid = cylinders[:, :-1].reshape(-1, 5)
    low = solid[:, CYL_Z_MIN] < simulator.config.robot.height_m
    radius = np.where(low, solid[:, CYL_RADIUS], 0.0)
    return np.stack([solid[:, CYL_X], solid[:, CYL_Y], radius], axis=1)
