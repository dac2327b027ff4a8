"""Where to go next, on the way to the goal past what has been seen: what a policy is shown for its goal.

A policy sees the last moments. Where a way ends blind, or two are about as good, it turns to and fro; what it needs is
what the robot has seen since it began, and a choice that lasts. The shortest way through the map of what stands
(`static_map`; what has not been seen is free, who walks is not in it) is looked for again and again, at once when
something stands before the robot that was not there; the place some way along it is kept until another way is clearly
shorter.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from densecavoid.frames import (
    CameraConfig,
    LidarConfig,
    RobotConfig,
    SensorFrame,
    goal_polar,
    seen_from,
    wrap_angle,
)
from densecavoid.perception.outlook_kernels import Around
from densecavoid.perception.people_around import People
from densecavoid.perception.rolling_grid import CELL_M
from densecavoid.perception.static_map import CELLS, StaticMap
from densecavoid.perception.ways import BLOCKED_SLOWER, WayRules, find_ways
from densecavoid.sim._jit import for_worlds, inner, kernel, threads_for

AHEAD_M = 2.0
"""So far along the way lies the place that is shown."""
SHORTER_M = 1.0
"""Another way must be shorter by so much: to turn round costs as much as a metre or two."""
_NEAR = 5.0  # cells: so near it is shown whatever lies between
_NOWHERE = 1e9
_SAME_GOAL_M = 0.3
_STRAIGHT = 2.0  # cells: a straight way may be so much longer than what was found
_RULES = WayRules(
    thing_m=0.37, body_m=0.30, near_m=0.25, near_slower=2.0, standing_m_s=0.12, cells=CELLS, cell_m=CELL_M
)
"""The paper's collision distance, and half a cell and a little more beside things, whose cells are not exactly where
they are: a gap is worth waiting for only if it is one in the coarser of two grids, too (`outlook`)."""


@inner
def _is_open(slowness, x, y):
    """Whether nothing is known to be in the way from the robot straight to a place, x and y in cells from it. Where it
    stands beside something already, that may lie behind it."""
    half = slowness.shape[0] // 2
    steps = int(math.hypot(x, y)) + 1
    left = False
    for k in range(steps + 1):
        i, j = half + math.floor(x * k / steps), half + math.floor(y * k / steps)
        if slowness[i, j] < BLOCKED_SLOWER:
            left = True
        elif left:
            return False
    return left


@inner
def _follow(distance, slowness, known, i, j, left):
    """The last cell that is in sight along the shortest way from another one, at most `left` cells on."""
    cells = distance.shape[0]
    half = cells // 2
    seen_i, seen_j = i, j
    while left > 0.0 and not known[i, j]:
        best_i, best_j = i, j
        for at_i in range(max(i - 1, 0), min(i + 2, cells)):
            for at_j in range(max(j - 1, 0), min(j + 2, cells)):
                if distance[at_i, at_j] < distance[best_i, best_j]:
                    best_i, best_j = at_i, at_j
        if best_i == i and best_j == j:
            break
        left -= math.hypot(best_i - i, best_j - j)
        i, j = best_i, best_j
        if math.hypot(i - half, j - half) < _NEAR or _is_open(slowness, i + 0.5 - half, j + 0.5 - half):
            seen_i, seen_j = i, j
    return seen_i, seen_j


@inner
def _next_place(distance, slowness, known, goal_x, goal_y, kept_x, kept_y, ahead, shorter):
    """Where to go next, and whether that is the goal. All places and lengths are counted in cells from the robot's.

    Args:
        kept_x, kept_y: what was said before, or `_NOWHERE`.
    """
    half = distance.shape[0] // 2
    to_goal, to_kept = math.hypot(goal_x, goal_y), math.hypot(kept_x, kept_y)
    # What grid and sweeping find is crooked by some degrees where nothing is in the way.
    part = min(ahead / max(to_goal, 1e-9), 1.0)
    x, y = part * goal_x, part * goal_y
    length = distance[half + math.floor(x), half + math.floor(y)] + part * to_goal
    if length < distance[half, half] + _STRAIGHT and _is_open(slowness, x, y):
        return x, y, part == 1.0
    i, j, left = half, half, ahead
    if to_kept < half - 1 and _is_open(slowness, kept_x, kept_y):
        at_i, at_j = half + math.floor(kept_x), half + math.floor(kept_y)
        if to_kept + distance[at_i, at_j] < distance[half, half] + shorter:
            i, j, left = at_i, at_j, left - to_kept
    i, j = _follow(distance, slowness, known, i, j, left)
    return i + 0.5 - half, j + 0.5 - half, known[i, j]


@inner
def _is_between(x, y, other_x, other_y, apart):
    """Whether a place is within a distance from the way straight to another, though not where the robot stands."""
    along = (x * other_x + y * other_y) / max(other_x * other_x + other_y * other_y, 1e-12)
    off_x, off_y = x - min(along, 1.0) * other_x, y - min(along, 1.0) * other_y
    return along > 0.0 and off_x * off_x + off_y * off_y < apart * apart < x * x + y * y


@inner
def _is_blocked(x, y, points, people, rules):
    """Whether something, or somebody who stands, is in the way straight to a place (m)."""
    for n in range(points.shape[0]):
        if _is_between(points[n, 0], points[n, 1], x, y, rules.body_m):
            return True
    pos, vel, radius, there = people
    for p in range(there.shape[0]):
        stands = there[p] and math.hypot(vel[p, 0], vel[p, 1]) < rules.standing_m_s
        if stands and _is_between(pos[p, 0], pos[p, 1], x, y, rules.body_m + radius[p]):
            return True
    return False


@kernel
def _look(
    first,
    last,
    which,
    due,
    fresh,
    goal,
    points,
    count,
    people,
    pose,
    goal_odom,
    rules,
    ahead,
    shorter,
    places,
    ways,
    ways_from,
):
    """Writes the next place and the ways where it is `due`, or something has come between.

    Args:
        which: bool [B] worlds.
        fresh: bool [B] where no place was shown before; changed.
        goal: f64 [B, 2] in the robot's frame.
        points, count: f32 [B, N, 2], [B] of what stands.
        people: `People`.
        pose, goal_odom: f64 [B, 3], [B, 2].
        rules: a `WayRules`.
        ahead, shorter: `AHEAD_M`, `SHORTER_M`.
        places: f64 [B, 2] (m, odometry's frame).
        ways: f32 [B, C, C] length of the way to the goal (m) from the cells of the map as it lay then,
        ways_from: f64 [B, 3] and the robot's pose, which the map lies around.
    """
    cells, cell = rules.cells, rules.cell_m
    distance, slowness = np.zeros((cells, cells)), np.zeros((cells, cells))
    known = np.zeros((cells, cells), np.bool_)
    for b in range(first, last):
        if not which[b]:
            continue
        cos, sin = math.cos(pose[b, 2]), math.sin(pose[b, 2])
        off_x, off_y = places[b, 0] - pose[b, 0], places[b, 1] - pose[b, 1]
        shown_x, shown_y = cos * off_x + sin * off_y, cos * off_y - sin * off_x
        seen, (pos, vel, radius, there, _) = points[b, : count[b]], people
        of_world = pos[b], vel[b], radius[b], there[b]
        if not due[b] and not _is_blocked(shown_x, shown_y, seen, of_world, rules):
            continue
        find_ways(distance, slowness, known, goal[b, 0], goal[b, 1], seen, *of_world, rules)
        # Cell by cell: to assign whole arrays, numba compiles how it would word an error for seconds.
        for row in range(cells):
            for column in range(cells):
                ways[b, row, column] = distance[row, column]
                distance[row, column] /= cell
        for axis in range(3):
            ways_from[b, axis] = pose[b, axis]
        kept_x = kept_y = _NOWHERE
        if not fresh[b]:
            kept_x, kept_y = shown_x / cell, shown_y / cell
        goal_x, goal_y = goal[b, 0] / cell, goal[b, 1] / cell
        of_way = distance, slowness, known, goal_x, goal_y, kept_x, kept_y, ahead / cell, shorter / cell
        x, y, arrives = _next_place(*of_way)
        if arrives:
            places[b, 0], places[b, 1] = goal_odom[b, 0], goal_odom[b, 1]
        else:
            places[b, 0] = pose[b, 0] + (cos * x - sin * y) * cell
            places[b, 1] = pose[b, 1] + (sin * x + cos * y) * cell
        fresh[b] = False


class Route:
    """One map and one next place a world."""

    def __init__(
        self,
        lidar: LidarConfig,
        camera: CameraConfig,
        every_steps: int,
        num_worlds: int,
        threads: int = 0,
        robot: RobotConfig = RobotConfig(),
    ) -> None:
        """
        Args:
            lidar, camera: whose frames it will be given.
            every_steps: frames after which the way is looked for again.
            num_worlds: B.
            threads: over the worlds; 0 takes all cores.
            robot: what begins above its height is in nobody's way.
        """
        self._map = StaticMap(lidar, camera, robot, num_worlds, threads)
        self._every_steps, self._threads = every_steps, threads
        self._fresh = np.ones(num_worlds, np.bool_)
        self._age: Int[np.ndarray, "B"] = np.zeros(num_worlds, np.int64)
        self._places: Float[np.ndarray, "B 2"] = np.zeros((num_worlds, 2))
        self._goal: Float[np.ndarray, "B 2"] = np.zeros((num_worlds, 2))
        self._ways: Float32[np.ndarray, "B C C"] = np.zeros((num_worlds, CELLS, CELLS), np.float32)
        self._ways_from: Float[np.ndarray, "B 3"] = np.zeros((num_worlds, 3))

    def reset(self, which: Bool[np.ndarray, "B"]) -> None:
        """Forgets what was seen in the marked worlds."""
        self._map.reset(which)
        self._fresh[which] = True
        self._age[which] = 0

    def update(
        self, frame: SensorFrame, people: People, which: Bool[np.ndarray, "B"]
    ) -> tuple[Float[np.ndarray, "B"], Float[np.ndarray, "B"]]:
        """Takes in the next frame of the marked worlds.

        Args:
            frame: of the sensors.
            people: who is known; those who stand are in the way, and nobody leaves a trail in the map.
            which: worlds.

        Returns:
            Distance (m) and bearing (rad) of the next place, for all worlds; it never seems nearer than the goal.
        """
        self._map.update(frame, people, which)
        goal = seen_from(frame.odom_pose, frame.goal_odom[:, None])[:, 0]
        # Another goal has another way; one that is given in a map moves a little with each correction of the odometry.
        other = which & ~(np.hypot(*(frame.goal_odom - self._goal).T) < _SAME_GOAL_M)
        self._goal[other] = frame.goal_odom[other]
        self._fresh[other] = True
        self._age[other] = 0
        # To what is no number there is no way to look for.
        known = which & np.isfinite(goal).all(axis=1)
        due = known & (self._age % self._every_steps == 0)
        self._age[which] += 1
        for_worlds(
            _look,
            len(which),
            threads_for(known, self._threads),
            known,
            due,
            self._fresh,
            goal,
            self._map.points,
            self._map.count,
            tuple(people),
            frame.odom_pose,
            frame.goal_odom,
            _RULES,
            AHEAD_M,
            SHORTER_M,
            self._places,
            self._ways,
            self._ways_from,
        )
        distance, _ = goal_polar(frame.odom_pose, frame.goal_odom)
        to_place, bearing = goal_polar(frame.odom_pose, self._places)
        return np.maximum(distance, to_place), bearing

    def around(self, frame: SensorFrame, people: People) -> Around:
        """What the way was looked for in, after an update with the same frame and people."""
        goal = seen_from(frame.odom_pose, frame.goal_odom[:, None])[:, 0]
        moved = seen_from(self._ways_from, frame.odom_pose[:, None, :2])[:, 0]
        turned = wrap_angle(frame.odom_pose[:, 2] - self._ways_from[:, 2])
        way_from = np.column_stack([moved, turned])
        return Around(goal, self._map.points, self._map.count, *people, self._ways, way_from)

    def state_dict(self) -> dict[str, np.ndarray]:
        """The memory of all worlds, as arrays."""
        own = {"fresh": self._fresh, "age": self._age, "places": self._places, "goal": self._goal}
        own |= {"ways": self._ways, "ways_from": self._ways_from}
        own = {name: value.copy() for name, value in own.items()}
        return own | {f"map.{name}": value for name, value in self._map.state_dict().items()}

    def load_state_dict(self, arrays: dict[str, np.ndarray]) -> None:
        """Goes on from a `state_dict`."""
        of_map = {name.removeprefix("map."): value for name, value in arrays.items() if name.startswith("map.")}
        self._map.load_state_dict(of_map)
        self._fresh, self._age = np.array(arrays["fresh"]), np.array(arrays["age"])
        self._places, self._goal = np.array(arrays["places"]), np.array(arrays["goal"])
        self._ways, self._ways_from = np.array(arrays["ways"]), np.array(arrays["ways_from"])
