"""Place `crossing`: two corridors cross, and the robot must pass through a flow at right angles to its own way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from densecavoid.scenarios.levelled import Levelled
from densecavoid.scenarios.world_builder import WorldBuilder, first_that_fits
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.spec import WorldSpec

_ARM_M = 8.0  # from the middle to the end of each corridor's walls
_BEYOND_M = 6.0  # people come from and go so far beyond the walls


@dataclass(frozen=True)
class Crossing(Levelled):
    """The robot goes along +x. Level 0: three people come across it, one way; level 1: up to 24, both ways, and some
    along its own corridor."""

    @property
    def name(self) -> str:
        return "crossing"

    def spawn(self, rng: np.random.Generator) -> WorldSpec:
        return first_that_fits(self.name, lambda: self._world(rng))

    def _world(self, rng: np.random.Generator) -> WorldSpec:
        along, across = rng.uniform(2.6, 4.5), rng.uniform(2.6, 5.0)
        plan, t = FloorPlan(), 0.05
        for x in (-1.0, 1.0):
            for y in (-1.0, 1.0):
                corner = x * (across / 2 + t), y * (along / 2 + t)
                plan.wall(*corner, x * _ARM_M, corner[1])
                plan.wall(*corner, corner[0], y * _ARM_M)

        builder = WorldBuilder(rng, self.name, plan, (-_ARM_M, -_ARM_M, _ARM_M, _ARM_M))
        reach, side = rng.uniform(4.0, 6.5), along / 2 - 0.5
        builder.robot((-reach - 0.5, -side, -reach, side), (reach, -side, reach + 0.5, side))
        speed = (rng.uniform(0.3, 0.5 + 0.5 * self.level), 0.15)
        people = 3 + int(rng.uniform(0.5, 1.0) * self.level * 21)
        counter = int(rng.uniform(0.0, 0.5) * people) if rng.random() < self.level else 0
        own = int(rng.uniform(0.0, 0.35) * self.level * people)
        half, far = across / 2 - 0.4, _ARM_M + _BEYOND_M
        direction = float(rng.choice([-1.0, 1.0]))
        for count, sign in ((people - counter - own, direction), (counter, -direction)):
            start = (-half, -far, half, 2.0) if sign > 0 else (-half, -2.0, half, far)
            builder.flow(count, start, (0.0, sign * (2 * far + 2.0)), speed)
        half = along / 2 - 0.4
        builder.flow(own, (-reach + 2.0, -half, far, half), (-2 * far - 2.0, 0.0), speed)
        return builder.world()
