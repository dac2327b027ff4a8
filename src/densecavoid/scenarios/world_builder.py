"""Sets up a world on a floor plan step by step: the robot's way first, then people who stand, then people who walk."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from densecavoid.frames import require
from densecavoid.scenarios.free_space import Area, Ground, clear_path, free_points, points_along
from densecavoid.scenarios.walk_net import walk_net
from densecavoid.sim.clearance import FOR_PEOPLE, FOR_ROBOT, clearances_m
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.people import CIRCULATING, STANDING, WANDERING, sample_bodies
from densecavoid.sim.spec import Crowd, WalkNet, WorldSpec

"""What people of a flow do."""

WAY_CLEARANCE_M = 0.38
END_CLEARANCE_M = 0.5
_WAYPOINT_SPACING_M = 2.0
_FROM_ROBOT_M = 1.5  # between the robot's start and a person's centre
_GAP_M = 0.1  # between bodies at the start
_TRIES = 60
_TALKING_M = {2: 0.5, 3: 0.62, 4: 0.75}
"""Radius of the ring on which so many people stand who talk: about a metre to the next (Hall's personal distance)."""


def first_that_fits(name: str, build: Callable[[], WorldSpec], tries: int = 30) -> WorldSpec:
    """The first world that `build` finds room for.

    Raises:
        ValueError: naming the scenario and what there was no room for, when none of so many tries succeeds.
    """
    for attempt in range(tries):
        try:
            return build()
        except ValueError as error:
            if attempt == tries - 1:
                raise ValueError(f"{name}: {error} (in the last of {tries} tries)") from error
    raise AssertionError


class WorldBuilder:
    """Collects what a world needs; `robot` comes first, then `talkers` and `standing`, then walkers."""

    def __init__(
        self,
        rng: np.random.Generator,
        name: str,
        plan: FloorPlan,
        area: Area,
        ground: Ground | None = None,
        cell_m: float = 0.1,
    ) -> None:
        """Begins with nobody.

        Args:
            rng: draws everything.
            name: of the scenario.
            plan: what stands there.
            area: where everything takes place.
            ground: tells which points are places to be; None: all that are free.
            cell_m: of the grid on which the robot's way is found.
        """
        self.rng, self.name, self.plan, self.area, self.ground = rng, name, plan, area, ground
        self._cell_m = cell_m
        self._with_standing = plan.copy()
        self._people: list[tuple[float, ...]] = []  # x, y, goal x, goal y, speed, radius, height, behaviour, heading
        self._group: list[int] = []
        self._leg: list[tuple[int, int]] = []
        self._entrance: list[Float[np.ndarray, "2"]] = []
        self._net: WalkNet | None = None
        self._groups = 0

    # -- the robot -----------------------------------------------------------------------------------------------------

    def robot(self, start_area: Area, goal_area: Area, distance_m: tuple[float, float] = (0.0, math.inf)) -> None:
        """Draws start and goal with a clear way between them.

        Raises:
            ValueError: if there are none so far apart with a clear way.
        """
        starts = free_points(self.rng, self.plan, start_area, 8, END_CLEARANCE_M)
        goals = free_points(self.rng, self.plan, goal_area, 8, END_CLEARANCE_M)
        for start, goal in zip(starts.tolist(), goals.tolist(), strict=True):
            if distance_m[0] <= math.dist(start, goal) <= distance_m[1] and self.robot_at(
                (start[0], start[1]), (goal[0], goal[1])
            ):
                return
        raise ValueError(f"no start in {start_area} and goal in {goal_area}, {distance_m} m apart, with a clear way")

    def robot_at(self, start: tuple[float, float], goal: tuple[float, float], heading_rad: float | None = None) -> bool:
        """Takes this start and goal; False, and nothing taken, if no clear way joins them."""
        path = self._way(self._with_standing, start, goal)
        if path is None:
            return False
        self.start, self.goal, self.path = start, goal, path
        ahead = path[min(len(path) - 1, 8)]
        towards = math.atan2(ahead[1] - start[1], ahead[0] - start[0]) + self.rng.uniform(-0.4, 0.4)
        self._heading = towards if heading_rad is None else heading_rad
        return True

    def _way(
        self, plan: FloorPlan, start: tuple[float, float], goal: tuple[float, float]
    ) -> Float[np.ndarray, "N 2"] | None:
        return clear_path(plan, start, goal, self.area, WAY_CLEARANCE_M, self._cell_m, self.ground)

    # -- people who stand ----------------------------------------------------------------------------------------------

    def talkers(self, groups: int, area: Area | None = None) -> None:
        """Adds up to `groups` rings of two to four people who talk, face to face, where the robot still gets by."""
        for _ in range(groups):
            self._ring(int(self.rng.choice([2, 2, 3, 4])), area or self.area)

    def talking(self, people: int, area: Area | None = None) -> None:
        """Adds so many people in rings of two to four who talk.

        Raises:
            ValueError: if there is no room for so many, or it is one alone.
        """
        require(people != 1, "people who talk", people, "2 or more")
        left = people
        while left > 0:
            count = left if left in (2, 3) else min(int(self.rng.choice([2, 2, 3, 4])), left)
            count = 2 if left - count == 1 and count > 2 else count + (left - count == 1)
            if not self._ring(count, area or self.area):
                raise ValueError(f"no room for {people} people who talk in {area or self.area}, {left} are left")
            left -= count

    def bystanders(self, people: int, area: Area | None = None) -> None:
        """Adds people who stand alone and look anywhere.

        Raises:
            ValueError: if there is no room for so many.
        """
        where = area or self.area
        for k in range(people):
            for _ in range(_TRIES):
                pos = self.rng.uniform(where[:2], where[2:])[None]
                if self.standing(pos, self.rng.uniform(-math.pi, math.pi, 1)):
                    break
            else:
                raise ValueError(f"no room for {people} people who stand in {where}, {people - k} are left")

    def _ring(self, count: int, area: Area) -> bool:
        ring = _TALKING_M[count]
        for _ in range(_TRIES // 2):
            centre = self.rng.uniform(area[:2], area[2:])
            if clearances_m(self.plan, centre[None], 3.0, FOR_PEOPLE)[0] < ring + 0.6:
                continue
            angles = self.rng.uniform(0, 2 * math.pi) + 2 * math.pi * np.arange(count) / count
            angles = angles + self.rng.normal(0, 0.12, count)
            pos = centre + ring * np.stack([np.cos(angles), np.sin(angles)], axis=1)
            if self._stand(pos, angles + math.pi, group=self._groups):
                self._groups += 1
                return True
        return False

    def standing(self, pos: Float[np.ndarray, "P 2"], heading_rad: Float[np.ndarray, "P"]) -> bool:
        """Adds people who stand alone, all or none of them: False if there is no room or the robot's way is closed."""
        return self._stand(pos, heading_rad, group=-1)

    def _stand(self, pos: np.ndarray, heading: np.ndarray, group: int) -> bool:
        radius, height = sample_bodies(self.rng, len(pos))
        if not all(self._fits(p, r) for p, r in zip(pos, radius, strict=True)):
            return False
        plan = self._with_standing.copy()
        for (x, y), r in zip(pos.tolist(), radius.tolist(), strict=True):
            plan.pillar(x, y, r)
        path = self._way(plan, self.start, self.goal)
        if path is None:
            return False
        self._with_standing, self.path = plan, path
        for p, r, h, angle in zip(pos, radius, height, heading, strict=True):
            self._add(p, p, 0.5, r, h, STANDING, float(angle), group)
        return True

    # -- people who walk -----------------------------------------------------------------------------------------------

    def walkers(self, count: int, speed: tuple[float, float], cell_m: float = 0.2) -> None:
        """Adds people who walk about at N(*speed) m/s from place to place in sight of one another.

        Ways are found on cells of `cell_m`; larger ones do where no door is narrow.

        Raises:
            ValueError: if there is no room for so many.
        """
        if count:
            self.walkers_on(self.net(cell_m), count, speed)

    def net(self, cell_m: float = 0.2) -> WalkNet:
        """Places in sight of one another, clear of everybody who stands.

        Raises:
            ValueError: if there is no room to walk.
        """
        return walk_net(self.rng, self._with_standing, self.area, self.start, cell_m, self.ground)

    def walkers_on(self, net: WalkNet, count: int, speed: tuple[float, float]) -> None:
        """The same on a given net."""
        self._net = net
        ways = [(a, int(b)) for a, row in enumerate(net.links) for b in row if b >= 0]
        length = np.array([math.dist(net.places[a, :2], net.places[b, :2]) + 0.3 for a, b in ways])
        for _ in range(count):
            radius, height = self._body()
            for _ in range(_TRIES):
                a, b = ways[self.rng.choice(len(ways), p=length / length.sum())]
                share = self.rng.uniform(0.0, 1.0)
                spread = self._within((1 - share) * net.places[a, 2] + share * net.places[b, 2])
                pos = (1 - share) * net.places[a, :2] + share * net.places[b, :2] + spread
                if self._fits(pos, radius):
                    goal = net.places[b, :2] + self._within(net.places[b, 2])
                    self._add(pos, goal, self._speed(speed), radius, height, WANDERING, None, -1, (a, b))
                    break
            else:
                raise ValueError(f"no room for {count} walkers, found places for {len(self._people)} people")

    def flow(
        self, count: int, area: Area, towards: tuple[float, float], speed: tuple[float, float], pairs: float = 0.25
    ) -> None:
        """Adds people who start in `area` and walk by the offset `towards` (m), a share `pairs` of them two by two.

        Who has arrived comes in again at the edge of `area` that the flow comes from, so that it never thins out.

        Raises:
            ValueError: if there is no room for so many.
        """
        way = np.array(towards) / math.hypot(*towards)
        aside = np.array([-way[1], way[0]])
        corners = np.array([(x, y) for x in area[::2] for y in area[1::2]])
        edge = float((corners @ way).min())
        left = count
        while left > 0:
            members = 2 if left >= 2 and self.rng.random() < pairs else 1
            bodies = [self._body() for _ in range(members)]
            for _ in range(_TRIES):
                pos = self.rng.uniform(area[:2], area[2:])
                places = [pos] if members == 1 else [pos - 0.36 * aside, pos + 0.36 * aside]
                if all(self._fits(p, r) for p, (r, _) in zip(places, bodies, strict=True)):
                    break
            else:
                raise ValueError(f"no room for a flow of {count} in {area}, {left} are left")
            group, pace = (self._groups, self._speed(speed)) if members == 2 else (-1, self._speed(speed))
            self._groups += members == 2
            for p, (r, h) in zip(places, bodies, strict=True):
                entrance = p - (float(p @ way) - edge) * way
                self._add(p, p + np.array(towards), pace, r, h, CIRCULATING, None, group, entrance=entrance)
            left -= members

    # -- the world -----------------------------------------------------------------------------------------------------

    def crowd(self, changes_of_mind_per_s: float = 0.01) -> Crowd:
        """Everybody who was added."""
        if not self._people:
            return Crowd.nobody()
        rows = np.array(self._people)
        return Crowd(
            pos=rows[:, 0:2],
            goal=rows[:, 2:4],
            preferred_speed=rows[:, 4],
            radius_m=rows[:, 5],
            height_m=rows[:, 6],
            behaviour=rows[:, 7].astype(np.int64),
            changes_of_mind_per_s=changes_of_mind_per_s,
            heading_rad=rows[:, 8],
            group=np.array(self._group),
            entrance=np.array(self._entrance, np.float64),
            net=self._net,
            leg=None if self._net is None else np.array(self._leg),
        )

    def world(self, time_limit_s: float | None = None) -> WorldSpec:
        """The world; unless given, with time for three times the way at .9 m/s, and at least 60 s."""
        length = float(np.hypot(*np.diff(self.path, axis=0).T).sum())
        return WorldSpec(
            scenario=self.name,
            floor_plan=self.plan,
            start_pose=(*self.start, self._heading),
            goal=self.goal,
            crowd=self.crowd(),
            time_limit_s=time_limit_s or max(60.0, 3.3 * length),
            waypoints=points_along(self.path, _WAYPOINT_SPACING_M),
        )

    # -- inside --------------------------------------------------------------------------------------------------------

    def _body(self) -> tuple[float, float]:
        radius, height = sample_bodies(self.rng, 1)
        return float(radius[0]), float(height[0])

    def _speed(self, speed: tuple[float, float]) -> float:
        return float(np.clip(self.rng.normal(*speed), 0.15, 1.6))

    def _within(self, spread: float) -> np.ndarray:
        away, angle = spread * math.sqrt(self.rng.random()), self.rng.uniform(0, 2 * math.pi)
        return away * np.array([math.cos(angle), math.sin(angle)])

    def _fits(self, pos: np.ndarray, radius: float) -> bool:
        """Whether a body has room: to things (low ones too), to people who are there and to the robot."""
        if math.dist(pos, self.start) < _FROM_ROBOT_M:
            return False
        if any(math.dist(pos, p[:2]) < radius + p[5] + _GAP_M for p in self._people):
            return False
        here = np.asarray(pos, np.float64)[None]
        if self.ground is not None and not self.ground(here)[0]:
            return False
        return all(clearances_m(self.plan, here, 1.0, h)[0] > radius + 0.03 for h in (FOR_PEOPLE, FOR_ROBOT))

    def _add(self, pos, goal, speed, radius, height, behaviour, heading, group, leg=(-1, -1), entrance=None) -> None:
        if heading is None:
            heading = math.atan2(goal[1] - pos[1], goal[0] - pos[0])
        self._people.append((*map(float, (*pos, *goal, speed, radius, height, behaviour, heading)),))
        self._group.append(group)
        self._leg.append(leg)
        self._entrance.append(pos if entrance is None else entrance)
