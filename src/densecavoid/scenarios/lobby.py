"""Place `lobby`: a hall with counters, sofas, plants and pillars, people who talk and people who cross."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from densecavoid.scenarios.furniture import against_walls, scatter
from densecavoid.scenarios.levelled import Levelled
from densecavoid.scenarios.world_builder import WorldBuilder, first_that_fits
from densecavoid.sim.clearance import clearances_m
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.furniture import counter, place
from densecavoid.sim.spec import WorldSpec


@dataclass(frozen=True)
class Lobby(Levelled):
    """Glass front with an entrance, counters at the back. Level 0: 4 people walk; level 1: up to 18, and 5 groups."""

    @property
    def name(self) -> str:
        return "lobby"

    def spawn(self, rng: np.random.Generator) -> WorldSpec:
        return first_that_fits(self.name, lambda: self._world(rng))

    def _world(self, rng: np.random.Generator) -> WorldSpec:
        length, depth = rng.uniform(12.0, 17.0), rng.uniform(9.0, 12.0)
        area = (0.0, 0.0, length, depth)
        plan = FloorPlan(ceiling_m=rng.uniform(2.6, 4.5))
        _shell(plan, length, depth, entrance=rng.uniform(0.3, 0.7) * length)

        # Counters stand in a row, with room behind them for those who serve.
        counters = int(rng.integers(1, 4))
        first = rng.uniform(2.2, max(2.3, length - 3.2 * counters))
        desks = [first + 3.2 * k for k in range(counters) if first + 3.2 * k < length - 1.6]
        for x in desks:
            counter(plan, x, depth - 1.6, -math.pi / 2)
        keep = [(x, depth - 1.6, 1.6) for x in desks]
        for x in np.arange(rng.uniform(2.5, 4.5), length - 2.0, rng.uniform(4.0, 5.5)):
            for y in (depth * 0.33, depth * 0.62):
                plan.pillar(float(x), y, 0.25)
        for _ in range(int(rng.integers(1, 4))):
            _seats(rng, plan, length, depth)
        against_walls(rng, plan, area, ("plant", "plant", "sofa", "vending-machine", "shelf"), 6, keep)
        scatter(rng, plan, (1.0, 1.0, length - 1.0, depth - 3.0), ("plant", "bin", "trolley"), 4, 0.9)

        builder = WorldBuilder(rng, self.name, plan, area)
        builder.robot((0.6, 0.6, length - 0.6, depth - 2.6), (0.6, 0.6, length - 0.6, depth - 2.6), (5.0, 12.0))
        for x in desks:
            builder.standing(np.array([[x + rng.uniform(-0.6, 0.6), depth - 0.7]]), np.array([-math.pi / 2]))
        builder.talkers(int(rng.uniform(0.4, 1.0) * (1 + 4 * self.level)), (1.0, 1.0, length - 1.0, depth - 2.4))
        speed = rng.uniform(0.4, 0.6 + 0.5 * self.level)
        builder.walkers(4 + int(rng.uniform(0.5, 1.0) * self.level * 14), (speed, 0.2), cell_m=0.3)
        return builder.world()


def _shell(plan: FloorPlan, length: float, depth: float, entrance: float) -> None:
    """Three walls, and at y = 0 a glass front between posts with an entrance 2 m wide, its doors open."""
    t = 0.05
    plan.wall(-t, -t, -t, depth + t)
    plan.wall(-t, depth + t, length + t, depth + t)
    plan.wall(length + t, -t, length + t, depth + t)
    plan.wall(0.1, -t, length - 0.1, -t, 0.04, "glass", doors=[(entrance - 0.1, 2.0)])
    for x in np.linspace(0.0, length, round(length / 2.5) + 1)[1:-1].tolist():
        if abs(x - entrance) > 1.1:
            plan.box(x, -t, 0.06, 0.1, 0.0, 0.0, 2.5, "metal")
    # What the entrance leads to is not part of the world: a dark mat's length outside ends at a windbreak.
    plan.wall(entrance - 1.2, -1.6, entrance + 1.2, -1.6, material="metal")
    for x in (entrance - 1.2, entrance + 1.2):
        plan.wall(x, -1.5, x, -0.2, 0.04, "glass")


def _seats(rng: np.random.Generator, plan: FloorPlan, length: float, depth: float) -> None:
    """A sofa and one or two armchairs round a low table, where there is room."""
    for _ in range(20):
        centre = rng.uniform((2.4, 2.4), (length - 2.4, depth - 4.2))
        if clearances_m(plan, centre[None], 4.0)[0] < 2.6:
            continue
        yaw = float(rng.integers(4)) * math.pi / 2

        def spot(ahead: float, left: float, yaw: float = yaw, centre: np.ndarray = centre) -> tuple[float, float]:
            cos, sin = math.cos(yaw), math.sin(yaw)
            return float(centre[0] + cos * ahead - sin * left), float(centre[1] + sin * ahead + cos * left)

        plan.table(*spot(0.0, 0.0), 0.6, 1.0, yaw, 0.45)
        place(plan, "sofa", *spot(-1.1, 0.0), yaw)
        for left in (-0.6, 0.6)[: int(rng.integers(1, 3))]:
            place(plan, "armchair", *spot(1.15, left), yaw + math.pi)
        return
