"""Scenarios in a given building: where the robot starts and goes, and its crowd, drawn anew for each world.

Unless told otherwise, everything takes place in the largest region that the robot can get about in.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from densecavoid.frames import choose, require
from densecavoid.scenarios.free_space import Area, Ground, clear_path, clearance_grid_m
from densecavoid.scenarios.ros_map import RosMap
from densecavoid.scenarios.walk_net import walk_net
from densecavoid.scenarios.world_builder import END_CLEARANCE_M, WAY_CLEARANCE_M, WorldBuilder, first_that_fits
from densecavoid.sim.clearance import clearances_m
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.spec import WalkNet, WorldSpec

KINDS = ("wandering", "standing", "talking")
_AROUND_M = 15.0
"""Of a large building, the part that counts reaches so far around the robot's way."""
_WHOLE_M2 = 2000.0
"""A building no larger than this counts as a whole, and its people walk one net of places."""
_SEEN_M = 5.0  # sensors look so far beyond that part
_FINE_CELLS, _CELL_M = 700_000, 0.1
_REGION_CELLS = 1_500_000
_TRIES, _CANDIDATES = 8000, 400


@dataclass(frozen=True)
class CrowdLine:
    """People of one kind, as a plan file's `crowd` says."""

    people: int
    kind: str = "wandering"
    """wandering: from place to place. standing: alone. talking: in rings of two to four."""
    speed: tuple[float, float] = (1.3, 0.26)
    """Mean and standard deviation of the walking speed (m/s), clipped to [.15, 1.6]."""
    area: Area | None = None
    """Where they stand or talk; None: anywhere. Wanderers go everywhere."""

    def __post_init__(self) -> None:
        require(0 <= self.people <= 500, "people", self.people, "0 to 500")
        choose("kind", self.kind, KINDS)
        require(self.speed[0] > 0 and self.speed[1] >= 0, "speed", self.speed, "mean above 0, deviation 0 or more")


@dataclass(frozen=True)
class Spot:
    """Where the robot starts or goes: a point, an area to draw from, or anywhere."""

    at: tuple[float, float] | None = None
    heading_rad: float | None = None
    """Where it looks at the start; None: along its way."""
    area: Area | None = None


@dataclass(frozen=True)
class Building:
    """A floor plan, a robot and a crowd: everything but the plan is drawn anew for each world."""

    name: str
    floor_plan: FloorPlan
    ros_map: RosMap | None = None
    start: Spot = field(default_factory=Spot)
    goal: Spot = field(default_factory=Spot)
    crowd: tuple[CrowdLine, ...] = ()
    distance_m: tuple[float, float] = (4.0, 25.0)
    """Between start and goal, where one of them is drawn."""
    time_limit_s: float | None = None
    """None: three times what the way takes at .9 m/s, and at least 60 s."""

    def __post_init__(self) -> None:
        fixed = self.start.at is not None and self.goal.at is not None
        if fixed and not self._window_has_way():
            ends = f"from start {self.start.at} to goal {self.goal.at}"
            raise ValueError(f"{self.name}: no way of {WAY_CLEARANCE_M} m clearance {ends}")

    @cached_property
    def area(self) -> Area:
        """What holds the whole building."""
        boxes, cylinders = self.floor_plan.boxes, self.floor_plan.cylinders
        cos, sin = np.abs(np.cos(boxes[:, 2])), np.abs(np.sin(boxes[:, 2]))
        reach = np.stack([cos, sin, sin, cos], axis=1).reshape(-1, 2, 2) @ boxes[:, 3:5, None]
        points = [boxes[:, :2] - reach[..., 0], boxes[:, :2] + reach[..., 0]]
        points += [cylinders[:, :2] - cylinders[:, 2:3], cylinders[:, :2] + cylinders[:, 2:3]]
        if self.ros_map is not None:
            rows, cols = self.ros_map.cells.shape
            corners = np.array([[0, 0], [cols, 0], [0, rows], [cols, rows]], np.float64)
            points = [*points, self.ros_map.to_world(corners)]
        for spot in (self.start, self.goal):
            if spot.at is not None:
                points.append(np.array([spot.at]))
            if spot.area is not None:
                points.append(np.array(spot.area).reshape(2, 2))
        everything = np.concatenate(points)
        require(len(everything) > 0, f"{self.name}: plan", "empty", "walls, a map, or a start and a goal")
        low, high = everything.min(axis=0), everything.max(axis=0)
        return float(low[0]), float(low[1]), float(high[0]), float(high[1])

    @property
    def _small(self) -> bool:
        return (self.area[2] - self.area[0]) * (self.area[3] - self.area[1]) <= _WHOLE_M2

    @property
    def _ground(self) -> Ground | None:
        return None if self.ros_map is None else self.ros_map.is_free

    def spawn(self, rng: np.random.Generator) -> WorldSpec:
        return first_that_fits(self.name, lambda: self._world(rng))

    def _world(self, rng: np.random.Generator) -> WorldSpec:
        start, goal = self._ends(rng)
        area = self._around(start, goal)
        cells = (area[2] - area[0]) * (area[3] - area[1]) / _CELL_M**2
        cell_m = _CELL_M * max(1.0, math.sqrt(cells / _FINE_CELLS))
        plan = self.floor_plan
        if not self._small:
            x0, y0, x1, y1 = area
            plan = plan.cropped(x0 - _SEEN_M, y0 - _SEEN_M, x1 + _SEEN_M, y1 + _SEEN_M)
        builder = WorldBuilder(rng, self.name, plan, area, self._ground, cell_m)
        if not builder.robot_at(start, goal, self.start.heading_rad):
            raise ValueError(f"no way of {WAY_CLEARANCE_M} m clearance from {start} to {goal}")
        for line in self.crowd:
            if line.kind == "talking":
                builder.talking(line.people, line.area)
            elif line.kind == "standing":
                builder.bystanders(line.people, line.area)
        walking = [line for line in self.crowd if line.kind == "wandering" and line.people]
        if walking:
            net = self._net if self._small and len(walking) == len(self.crowd) else builder.net()
            for line in walking:
                builder.walkers_on(net, line.people, line.speed)
        return builder.world(self.time_limit_s)

    @cached_property
    def _net(self) -> WalkNet:
        """The whole building's net: the same for all its worlds."""
        rng = np.random.default_rng(0)
        near, _ = self._ends(rng)
        return walk_net(rng, self.floor_plan, self.area, near, ground=self._ground)

    def _around(self, start: tuple[float, float], goal: tuple[float, float]) -> Area:
        """The part of the building that counts for a way."""
        if self._small:
            return self.area
        low, high = np.minimum(start, goal) - _AROUND_M, np.maximum(start, goal) + _AROUND_M
        low, high = np.maximum(low, self.area[:2]), np.minimum(high, self.area[2:])
        return float(low[0]), float(low[1]), float(high[0]), float(high[1])

    def _window_has_way(self) -> bool:
        start, goal = self.start.at, self.goal.at
        assert start is not None and goal is not None
        area = self._around(start, goal)
        return clear_path(self.floor_plan, start, goal, area, WAY_CLEARANCE_M, ground=self._ground) is not None

    @cached_property
    def _regions(self) -> tuple[Int[np.ndarray, "X Y"], float]:
        """Regions of cells between which the robot can get about, by number (0: none), and the cells' size."""
        from scipy.ndimage import label  # here, because it takes a tenth of a second that few worlds need

        size = (self.area[2] - self.area[0]) * (self.area[3] - self.area[1])
        cell_m = max(_CELL_M, math.sqrt(size / _REGION_CELLS))
        # As far as a way may be from the nearest cell's centre, so that no narrow door is lost.
        least = max(0.05, WAY_CLEARANCE_M - cell_m * math.sqrt(0.5))
        free = clearance_grid_m(self.floor_plan, self.area, cell_m, WAY_CLEARANCE_M) >= least
        if self._ground is not None:
            free[free] = self._ground(np.array(self.area[:2]) + (np.argwhere(free) + 0.5) * cell_m)
        return label(free)[0], cell_m  # type: ignore[index]

    @cached_property
    def _largest_region(self) -> int:
        regions, _ = self._regions
        sizes = np.bincount(regions.ravel())[1:]
        if len(sizes) == 0:
            raise ValueError(f"{self.name}: no free space, expected places with {WAY_CLEARANCE_M} m to everything")
        return 1 + int(np.argmax(sizes))

    def _region_of(self, points: Float[np.ndarray, "N 2"]) -> Int[np.ndarray, "N"]:
        regions, cell_m = self._regions
        at = np.floor((points - self.area[:2]) / cell_m).astype(np.int64)
        at = np.clip(at, 0, np.array(regions.shape) - 1)
        return regions[at[:, 0], at[:, 1]].astype(np.int64)

    def _ends(self, rng: np.random.Generator) -> tuple[tuple[float, float], tuple[float, float]]:
        start, goal = self.start.at, self.goal.at
        region = self._largest_region
        for spot in (self.start, self.goal):
            if spot.at is not None:
                region = int(self._region_of(np.array([spot.at]))[0])
        starts = np.array([start]) if start else self._free(rng, self.start, "start", None, region)
        goals = np.array([goal]) if goal else self._free(rng, self.goal, "goal", starts[0], region)
        for a in starts:
            apart = np.hypot(*(goals - a).T)
            fits = np.flatnonzero((apart >= self.distance_m[0]) & (apart <= self.distance_m[1]))
            if start and goal:
                fits = np.zeros(1, np.int64)
            if len(fits):
                a_xy, b_xy = a.tolist(), goals[rng.choice(fits)].tolist()
                return (a_xy[0], a_xy[1]), (b_xy[0], b_xy[1])
        raise ValueError(f"no start and goal {self.distance_m} m apart")

    def _free(
        self, rng: np.random.Generator, spot: Spot, name: str, near: Float[np.ndarray, "2"] | None, region: int
    ) -> Float[np.ndarray, "N 2"]:
        """Some free places, in the spot's area, or anywhere (within reach of `near`)."""
        low, high = np.split(np.array(spot.area or self.area), 2)
        if spot.area is None and near is not None:
            low, high = np.maximum(low, near - self.distance_m[1]), np.minimum(high, near + self.distance_m[1])
        points = rng.uniform(low, high, (_TRIES, 2))
        points = points[self._region_of(points) == region]
        if self.ros_map is not None:
            points = points[self.ros_map.is_free(points)]
        points = points[:_CANDIDATES]
        points = points[clearances_m(self.floor_plan, points, 1.0) >= END_CLEARANCE_M]
        if len(points) == 0:
            raise ValueError(f"no free space for the robot's {name} in {spot.area or self.area}")
        return points
