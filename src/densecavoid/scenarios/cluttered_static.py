"""Training stage 2, Dense-Static: a room full of things and a random goal (paper, Training Scenarios)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from densecavoid.scenarios.free_space import clear_path, free_points, points_along
from densecavoid.scenarios.furniture import clutter
from densecavoid.scenarios.levelled import Levelled
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.spec import WorldSpec

_WAY_CLEARANCE_M = 0.45
_WAYPOINT_SPACING_M = 2.0
_MAX_ROOMS = 50


def cluttered_room(
    rng: np.random.Generator,
    name: str,
    size: tuple[float, float],
    count: int,
    goal_distance_m: tuple[float, float],
    time_limit_s: float = 60.0,
    cell_m: float = 0.1,
) -> WorldSpec:
    """A room of `size` (m) with `count` obstacles, a start and a goal so far apart that a clear way joins.

    Raises:
        ValueError: if no such room was found.
    """
    area = (0.0, 0.0, *size)
    inner = (0.6, 0.6, size[0] - 0.6, size[1] - 0.6)
    for _ in range(_MAX_ROOMS):
        plan = FloorPlan()
        plan.room(*area)
        clutter(rng, plan, area, count)
        ends = free_points(rng, plan, inner, 12, 0.5)
        apart = np.hypot(*(ends[0] - ends[1:]).T)
        fits = np.flatnonzero((apart >= goal_distance_m[0]) & (apart <= goal_distance_m[1]))
        if len(fits) == 0:
            continue
        start, goal = tuple(ends[0].tolist()), tuple(ends[1 + fits[0]].tolist())
        path = clear_path(plan, start, goal, area, _WAY_CLEARANCE_M, cell_m)
        if path is not None:
            return WorldSpec(
                scenario=name,
                floor_plan=plan,
                start_pose=(*start, rng.uniform(-math.pi, math.pi)),
                goal=goal,
                time_limit_s=time_limit_s,
                waypoints=points_along(path, _WAYPOINT_SPACING_M),
            )
    raise ValueError(f"{name}: no room of {size} m with {count} obstacles and a clear way in {_MAX_ROOMS} tries")


@dataclass(frozen=True)
class ClutteredStatic(Levelled):
    """Level 0 is a nearly empty room, level 1 has an obstacle for every 3 m2 and goals at least 5 m away."""

    @property
    def name(self) -> str:
        return "cluttered-static"

    def spawn(self, rng: np.random.Generator) -> WorldSpec:
        least = 6.0 + self.level
        size = (rng.uniform(least, 12.0), rng.uniform(least, 12.0))
        densest = size[0] * size[1] / 3.0
        count = int(rng.uniform(0.5, 1.0) * self.level * densest) + 1
        return cluttered_room(rng, self.name, size, count, (2.0 + 3.0 * self.level, 14.0), cell_m=0.15)
