"""Tests `dense-ped` and `corridor-15`: fifteen people come against the robot in a 4 m corridor (BENCHMARK)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from densecavoid.scenarios.free_space import free_points
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.people import TRAVERSING
from densecavoid.sim.spec import Crowd, WorldSpec

_START_X = 1.0
_BEYOND_M = 4.0  # people leave the world so far behind the robot's start


def corridor_plan(width: float, length: float) -> FloorPlan:
    """Two walls along +x from x = 0, open at both ends."""
    plan = FloorPlan()
    for y in (-width / 2 - 0.05, width / 2 + 0.05):
        plan.wall(0.0, y, length, y)
    return plan


def oncoming_corridor(
    rng: np.random.Generator,
    name: str,
    width: float,
    length: float,
    people: int,
    speed: tuple[float, float],
    ahead_m: tuple[float, float],
    goal_ahead_m: float,
    time_limit_s: float = 60.0,
) -> WorldSpec:
    """A corridor in which `people` who start `ahead_m` of the robot come towards it at N(*speed) m/s.

    Raises:
        ValueError: if there is no room for so many people.
    """
    plan = corridor_plan(width, length)
    side = width / 2 - 0.45
    where = (_START_X + ahead_m[0], -side, _START_X + ahead_m[1], side)
    pos = free_points(rng, plan, where, people, 0.4, apart_m=0.7)
    leave = np.stack([np.full(people, -_BEYOND_M), rng.uniform(-side, side, people)], axis=1)
    return WorldSpec(
        scenario=name,
        floor_plan=plan,
        start_pose=(_START_X, rng.uniform(-side + 0.4, side - 0.4), rng.uniform(-0.2, 0.2)),
        goal=(_START_X + goal_ahead_m, rng.uniform(-side + 0.4, side - 0.4)),
        crowd=Crowd.draw(rng, pos, leave, *speed, TRAVERSING),
        time_limit_s=time_limit_s,
    )


@dataclass(frozen=True)
class DensePed:
    """15 people at N(.33, .1) m/s, starting 3 to 23 m ahead; goal 15 m ahead."""

    @property
    def name(self) -> str:
        return "dense-ped"

    def spawn(self, rng: np.random.Generator) -> WorldSpec:
        return oncoming_corridor(rng, self.name, 4.0, 24.0, 15, (0.33, 0.1), (3.0, 23.0), 15.0)


@dataclass(frozen=True)
class Corridor15:
    """The hard one: 15 people at N(.5, .15) m/s, starting 3 to 13 m ahead."""

    @property
    def name(self) -> str:
        return "corridor-15"

    def spawn(self, rng: np.random.Generator) -> WorldSpec:
        return oncoming_corridor(rng, self.name, 4.0, 24.0, 15, (0.5, 0.15), (3.0, 13.0), 15.0)
