"""Test `random-sparse-ped`: ten people walking to random places of a hall (BENCHMARK, The four tests)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from densecavoid.scenarios.free_space import Area, free_points
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.people import WANDERING
from densecavoid.sim.spec import Crowd, WorldSpec

_PILLARS = (2, 4)
_BODY_ROOM_M = 0.4


def wandering_hall(
    rng: np.random.Generator,
    name: str,
    size: tuple[float, float],
    pillars: int,
    people: int,
    speed: tuple[float, float],
    goal_distance_m: tuple[float, float],
    changes_of_mind_per_s: float,
    time_limit_s: float = 60.0,
) -> WorldSpec:
    """A hall of `size` (m) with people walking to random places at speeds N(*speed) m/s.

    Raises:
        ValueError: if there is no room for robot, goal and people.
    """
    plan = FloorPlan()
    area: Area = (0.0, 0.0, *size)
    plan.room(*area)
    inner = (1.2, 1.2, size[0] - 1.2, size[1] - 1.2)
    for x, y in free_points(rng, plan, inner, pillars, 0.8, apart_m=2.0) if pillars else []:
        plan.pillar(float(x), float(y), rng.uniform(0.15, 0.3))
    walkable = (0.6, 0.6, size[0] - 0.6, size[1] - 0.6)
    for _ in range(200):
        start, goal = free_points(rng, plan, walkable, 2, 0.6)
        if goal_distance_m[0] <= math.dist(start, goal) <= goal_distance_m[1]:
            break
    else:
        raise ValueError(f"{name}: no start and goal {goal_distance_m} m apart in a hall of {size} m")
    start_xy = (float(start[0]), float(start[1]))
    pos = free_points(rng, plan, walkable, people, _BODY_ROOM_M, apart_m=0.8, away_from=start_xy, away_m=1.5)
    places = free_points(rng, plan, walkable, people, _BODY_ROOM_M) if people else np.zeros((0, 2))
    return WorldSpec(
        scenario=name,
        floor_plan=plan,
        start_pose=(*start_xy, rng.uniform(-math.pi, math.pi)),
        goal=(float(goal[0]), float(goal[1])),
        crowd=Crowd.draw(rng, pos, places, *speed, WANDERING, walkable, changes_of_mind_per_s),
        time_limit_s=time_limit_s,
    )


@dataclass(frozen=True)
class RandomSparsePed:
    """Hall of 8 x 8 m, ten people at N(.5, .15) m/s who change their mind at random, goal about 5 m away."""

    @property
    def name(self) -> str:
        return "random-sparse-ped"

    def spawn(self, rng: np.random.Generator) -> WorldSpec:
        pillars = int(rng.integers(_PILLARS[0], _PILLARS[1] + 1))
        return wandering_hall(rng, self.name, (8.0, 8.0), pillars, 10, (0.5, 0.15), (4.5, 5.5), 0.1)
