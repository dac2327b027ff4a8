"""Place `plaza`: outdoors, with kerbs and ramps that the lidar looks over, benches, trees, and people about."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from densecavoid.scenarios.furniture import scatter
from densecavoid.scenarios.levelled import Levelled
from densecavoid.scenarios.world_builder import WorldBuilder, first_that_fits
from densecavoid.sim.clearance import clearances_m
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.furniture import kerb, place, ramp
from densecavoid.sim.spec import WorldSpec


@dataclass(frozen=True)
class Plaza(Levelled):
    """No ceiling, a facade on one side. Level 0: four people and one bed; level 1: up to 26 and four, between kerbs."""

    @property
    def name(self) -> str:
        return "plaza"

    def spawn(self, rng: np.random.Generator) -> WorldSpec:
        return first_that_fits(self.name, lambda: self._world(rng))

    def _world(self, rng: np.random.Generator) -> WorldSpec:
        length, depth = rng.uniform(13.0, 18.0), rng.uniform(11.0, 15.0)
        plan = FloorPlan(ceiling_m=math.inf)
        _facade(rng, plan, length, depth)
        _pavement(rng, plan, length)
        for _ in range(1 + round(3 * self.level)):
            _bed(rng, plan, length, depth)
        inside = (1.0, 2.5, length - 1.0, depth - 1.0)
        scatter(rng, plan, inside, ("bench", "bench", "planter"), 3 + int(3 * self.level), 1.0)
        scatter(rng, plan, inside, ("bin", "lamp-post", "tree"), 5, 0.9)

        area = (0.0, 1.9, length, depth)
        builder = WorldBuilder(rng, self.name, plan, area)
        inside = (0.7, 2.6, length - 0.7, depth - 0.7)
        builder.robot(inside, inside, (6.0, 13.0))
        builder.talkers(int(rng.uniform(0.3, 1.0) * (1 + 4 * self.level)))
        speed = rng.uniform(0.5, 0.7 + 0.6 * self.level)
        builder.walkers(4 + int(rng.uniform(0.5, 1.0) * self.level * 14), (speed, 0.25), cell_m=0.3)
        return builder.world()


def _facade(rng: np.random.Generator, plan: FloorPlan, length: float, depth: float) -> None:
    """A house along y = depth with a shop window, and a step up to its door with a ramp beside it."""
    window = rng.uniform(3.0, 5.0)
    x = rng.uniform(2.0, length - 2.0 - window)
    y = depth + 0.2
    for begin, end in ((-1.0, x), (x + window, length + 1.0)):
        plan.box((begin + end) / 2, y, end - begin, 0.4, 0.0, 0.0, 6.0, "concrete")
    plan.box(x + window / 2, y, window, 0.04, 0.0, 0.4, 2.5, "glass")
    plan.box(x + window / 2, y, window, 0.4, 0.0, 0.0, 0.4, "concrete")
    plan.box(x + window / 2, y, window, 0.4, 0.0, 2.5, 6.0, "concrete")
    door = x - 1.2 if x > length / 2 else x + window + 1.2
    height = rng.uniform(0.10, 0.15)
    plan.box(door, depth - 0.6, 1.4, 1.2, 0.0, 0.0, height, "concrete")
    side = float(rng.choice([-1.0, 1.0]))
    ramp(plan, door + side * 1.3, depth - 0.6, 1.2, 1.2, 0.0 if side < 0 else math.pi, height)


def _pavement(rng: np.random.Generator, plan: FloorPlan, length: float) -> None:
    """The kerb of a pavement along y = 1.8, lowered at one place by two ramps that run out sideways."""
    height = rng.uniform(0.10, 0.15)
    gap = rng.uniform(3.0, length - 3.0)
    kerb(plan, -1.0, 1.8, gap - 1.4, 1.8, height)
    kerb(plan, gap + 1.4, 1.8, length + 1.0, 1.8, height)
    ramp(plan, gap - 1.0, 1.8, 0.6, 0.15, math.pi, height, 4)
    ramp(plan, gap + 1.0, 1.8, 0.6, 0.15, 0.0, height, 4)


def _bed(rng: np.random.Generator, plan: FloorPlan, length: float, depth: float) -> None:
    """A flower bed between kerbs with a tree or a low shrub, where there is room."""
    for _ in range(20):
        half = rng.uniform((0.8, 0.6), (1.6, 1.1))
        x, y = rng.uniform((2.2 + half[0], 3.6 + half[1]), (length - 2.2 - half[0], depth - 2.8 - half[1])).tolist()
        if clearances_m(plan, np.array([[x, y]]), 6.0)[0] < float(np.hypot(*half)) + 1.2:
            continue
        height, (a, b) = rng.uniform(0.10, 0.15), half.tolist()
        for x0, y0, x1, y1 in ((-a, -b, a, -b), (a, -b, a, b), (a, b, -a, b), (-a, b, -a, -b)):
            kerb(plan, x + x0, y + y0, x + x1, y + y1, height)
        if rng.random() < 0.6:
            place(plan, "tree", x, y)
        else:
            plan.box(x, y, 2 * a - 0.4, 2 * b - 0.4, 0.0, 0.0, rng.uniform(0.16, 0.19), "plant")
        return
