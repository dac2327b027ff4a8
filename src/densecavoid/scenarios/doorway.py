"""Place `doorway`: two rooms joined by a door, and people who pass it both ways."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from densecavoid.scenarios.furniture import against_walls
from densecavoid.scenarios.levelled import Levelled
from densecavoid.scenarios.world_builder import WorldBuilder, first_that_fits
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.spec import WorldSpec

_FURNITURE = ("shelf", "shelf", "desk", "plant", "armchair", "vending-machine")


@dataclass(frozen=True)
class Doorway(Levelled):
    """The robot must pass the door. Level 0: a door of 1.6 to 2 m and two people; level 1: .95 to 1.35 m, up to 14."""

    @property
    def name(self) -> str:
        return "doorway"

    def spawn(self, rng: np.random.Generator) -> WorldSpec:
        return first_that_fits(self.name, lambda: self._world(rng))

    def _world(self, rng: np.random.Generator) -> WorldSpec:
        left, right, width = rng.uniform(4.0, 6.5), rng.uniform(4.0, 6.5), rng.uniform(4.0, 7.0)
        door_width = 1.6 - 0.65 * self.level + rng.uniform(0.0, 0.4)
        door = rng.uniform(0.3 + door_width / 2, width - 0.3 - door_width / 2)
        area = (-left, 0.0, right, width)
        plan = FloorPlan()
        plan.room(*area)
        plan.wall(0.0, 0.05, 0.0, width - 0.05, doors=[(door - 0.05, door_width)])
        keep = [(0.0, door, 1.4)]
        for room in ((-left, 0.0, -0.05, width), (0.05, 0.0, right, width)):
            against_walls(rng, plan, room, _FURNITURE, int(rng.integers(2, 5)), keep)

        builder = WorldBuilder(rng, self.name, plan, area)
        ends = [(-left + 0.5, 0.5, -1.2, width - 0.5), (1.2, 0.5, right - 0.5, width - 0.5)]
        if rng.random() < 0.5:
            ends.reverse()
        builder.robot(ends[0], ends[1], (3.5, 20.0))
        builder.talkers(int(rng.uniform(0.0, 2.0 * self.level + 0.5)))
        speed = rng.uniform(0.3, 0.5 + 0.5 * self.level)
        builder.walkers(2 + int(rng.uniform(0.5, 1.0) * self.level * 12), (speed, 0.2))
        return builder.world()
