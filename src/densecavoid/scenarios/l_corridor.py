"""Place `l-corridor`: a corridor round a corner that nobody sees past, and people both ways."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from densecavoid.scenarios.furniture import against_walls
from densecavoid.scenarios.levelled import Levelled
from densecavoid.scenarios.world_builder import WorldBuilder, first_that_fits
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.spec import WorldSpec


@dataclass(frozen=True)
class LCorridor(Levelled):
    """From one end, round the corner, to the other. Level 0: 3.6 to 4.4 m wide and two people; level 1: 2.4 to 3.2 m
    and up to 16."""

    @property
    def name(self) -> str:
        return "l-corridor"

    def spawn(self, rng: np.random.Generator) -> WorldSpec:
        return first_that_fits(self.name, lambda: self._world(rng))

    def _world(self, rng: np.random.Generator) -> WorldSpec:
        width = 3.6 - 1.2 * self.level + rng.uniform(0.0, 0.8)
        a, b = rng.uniform(7.0, 10.0), rng.uniform(7.0, 10.0)
        side = float(rng.choice([-1.0, 1.0]))  # the corner turns left or right
        plan, t = FloorPlan(), 0.05
        outline = [(0, 0), (a, 0), (a, b), (a - width, b), (a - width, width), (0, width)]
        outwards = [(-t, -t), (t, -t), (t, t), (-t, t), (-t, t), (-t, t)]
        corners = [(x + dx, side * (y + dy)) for (x, y), (dx, dy) in zip(outline, outwards, strict=True)]
        for (x0, y0), (x1, y1) in zip(corners, corners[1:] + corners[:1], strict=True):
            plan.wall(x0, y0, x1, y1)

        def turned(x0: float, y0: float, x1: float, y1: float) -> tuple[float, float, float, float]:
            return (x0, min(side * y0, side * y1), x1, max(side * y0, side * y1))

        corner = (a - width / 2, side * width / 2, 0.8 * width)
        arms = [turned(0.0, 0.0, a, width), turned(a - width, 0.0, a, b)]
        ends = [turned(0.5, 0.5, 1.5, width - 0.5), turned(a - width + 0.5, b - 1.5, a - 0.5, b - 0.5)]
        keep = [corner, (1.0, side * width / 2, 1.2), (a - width / 2, side * (b - 1.0), 1.2)]
        if width > 2.9:
            for arm in arms:
                against_walls(rng, plan, arm, ("plant", "bench", "vending-machine", "bin"), 2, keep)

        builder = WorldBuilder(rng, self.name, plan, turned(0.0, 0.0, a, b))
        if rng.random() < 0.5:
            ends.reverse()
        builder.robot(ends[0], ends[1])
        speed = rng.uniform(0.3, 0.5 + 0.5 * self.level)
        builder.walkers(2 + int(rng.uniform(0.5, 1.0) * self.level * 14), (speed, 0.2))
        return builder.world()
