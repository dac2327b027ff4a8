"""Free space in a floor plan: how far places are from things, random free places, and the shortest clear path."""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float

from densecavoid.sim._jit import kernel
from densecavoid.sim.clearance import FOR_PEOPLE, FOR_ROBOT, Heights, clearances_m, nearest_thing
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.geometry import (
    BOX_COS,
    BOX_HALF_LENGTH,
    BOX_HALF_WIDTH,
    BOX_SIN,
    BOX_X,
    BOX_Y,
    BOX_Z_MAX,
    BOX_Z_MIN,
    CYL_RADIUS,
    CYL_X,
    CYL_Y,
    CYL_Z_MAX,
    CYL_Z_MIN,
    disc_offset,
    rectangle_offset,
)

Area = tuple[float, float, float, float]
"""x_min, y_min, x_max, y_max."""

_MAX_TRIES = 2000


Ground = Callable[[Float[np.ndarray, "N 2"]], Bool[np.ndarray, "N"]]
"""Tells which points are places to be, where the plan alone does not (a map's unknown cells are not)."""

Point = Float[np.ndarray, "2"] | tuple[float, float]


@kernel
def _way_is_clear(x0, y0, x1, y1, room0, room1, boxes, cylinders, low, high):
    count = max(1, math.ceil(math.hypot(x1 - x0, y1 - y0) / 0.1))
    for k in range(count + 1):
        share = k / count
        need = (1.0 - share) * room0 + share * room1
        x, y = (1.0 - share) * x0 + share * x1, (1.0 - share) * y0 + share * y1
        if nearest_thing(x, y, boxes, cylinders, low, high, need) < need:
            return False
    return True


def way_is_clear(
    plan: FloorPlan,
    start: Point,
    end: Point,
    room_m: tuple[float, float],
    heights: Heights = FOR_PEOPLE,
) -> bool:
    """Whether a straight way keeps `room_m` to things, so much at its start and at its end, and between evenly less."""
    packed = plan.packed()
    ends = float(start[0]), float(start[1]), float(end[0]), float(end[1])
    rooms = float(room_m[0]), float(room_m[1])
    if not _way_is_clear(*ends, *rooms, packed.boxes, packed.cylinders, *heights):
        return False
    if not plan.meshes:
        return True
    share = np.linspace(0.0, 1.0, math.ceil(math.dist(ends[:2], ends[2:]) / 0.1) + 1)[:, None]
    need = ((1.0 - share) * rooms[0] + share * rooms[1])[:, 0]
    clear = clearances_m(plan, (1.0 - share) * np.array(ends[:2]) + share * np.array(ends[2:]), max(rooms), heights)
    return bool((clear >= need).all())


@kernel
def _spread_clearances(grid, x0, y0, cell, boxes, cylinders, low, high):
    """Lowers each cell of `grid` to its centre's distance to the nearest thing, thing by thing: few cells are near one.

    On entry `grid` holds the limit beyond which distances do not matter.
    """
    limit = grid[0, 0]
    for k in range(boxes.shape[0] + cylinders.shape[0]):
        is_box = k < boxes.shape[0]
        if is_box:
            box = boxes[k]
            if box[BOX_Z_MAX] <= low or box[BOX_Z_MIN] >= high:
                continue
            cos, sin = abs(box[BOX_COS]), abs(box[BOX_SIN])
            x, y = box[BOX_X], box[BOX_Y]
            reach_x = cos * box[BOX_HALF_LENGTH] + sin * box[BOX_HALF_WIDTH] + limit
            reach_y = sin * box[BOX_HALF_LENGTH] + cos * box[BOX_HALF_WIDTH] + limit
        else:
            cylinder = cylinders[k - boxes.shape[0]]
            if cylinder[CYL_Z_MAX] <= low or cylinder[CYL_Z_MIN] >= high:
                continue
            x, y = cylinder[CYL_X], cylinder[CYL_Y]
            reach_x = reach_y = cylinder[CYL_RADIUS] + limit
        first_row = max(0, math.floor((x - reach_x - x0) / cell))
        last_row = min(grid.shape[0], math.ceil((x + reach_x - x0) / cell) + 1)
        first_col = max(0, math.floor((y - reach_y - y0) / cell))
        last_col = min(grid.shape[1], math.ceil((y + reach_y - y0) / cell) + 1)
        for row in range(first_row, last_row):
            for col in range(first_col, last_col):
                at_x, at_y = x0 + (row + 0.5) * cell, y0 + (col + 0.5) * cell
                if is_box:
                    distance, _, _ = rectangle_offset(at_x, at_y, boxes[k])
                else:
                    distance, _, _ = disc_offset(at_x, at_y, cylinders[k - boxes.shape[0]])
                grid[row, col] = min(grid[row, col], distance)


def clearance_grid_m(
    plan: FloorPlan, area: Area, cell_m: float, limit_m: float, heights: Heights = FOR_ROBOT
) -> Float[np.ndarray, "X Y"]:
    """Distance from the centres of an area's cells to the nearest thing (negative inside); at most `limit_m`."""
    shape = [len(np.arange(area[axis] + cell_m / 2, area[axis + 2], cell_m)) for axis in (0, 1)]
    grid = np.full(shape, limit_m)
    packed = plan.packed()
    _spread_clearances(grid, area[0], area[1], cell_m, packed.boxes, packed.cylinders, *heights)
    if plan.meshes:
        places = [area[axis] + (np.arange(shape[axis]) + 0.5) * cell_m for axis in (0, 1)]
        centres = np.stack(np.meshgrid(*places, indexing="ij"), axis=-1).reshape(-1, 2)
        grid = np.minimum(grid, clearances_m(plan, centres, limit_m, heights).reshape(shape))
    return grid


@kernel
def _choose(candidates, room, clearance, apart, away_x, away_y, away, chosen, found):
    """Takes candidates [N, 2] with enough room into `chosen` [count, 2] after the `found` that are there; how many."""
    for n in range(candidates.shape[0]):
        if found == chosen.shape[0]:
            break
        x, y = candidates[n, 0], candidates[n, 1]
        fits = room[n] >= clearance and math.hypot(x - away_x, y - away_y) >= away
        for k in range(found):
            fits = fits and math.hypot(x - chosen[k, 0], y - chosen[k, 1]) >= apart
        if fits:
            chosen[found, 0], chosen[found, 1] = x, y
            found += 1
    return found


def free_points(
    rng: np.random.Generator,
    plan: FloorPlan,
    area: Area,
    count: int,
    clearance_m: float,
    apart_m: float = 0.0,
    away_from: tuple[float, float] | None = None,
    away_m: float = 0.0,
) -> Float[np.ndarray, "count 2"]:
    """Random places in an area, clear of things, of each other and of one given point.

    Raises:
        ValueError: if there is no room for them.
    """
    chosen, found = np.empty((count, 2)), 0
    low, high = np.array(area[:2]), np.array(area[2:])
    from_x, from_y = (0.0, 0.0) if away_from is None else away_from
    away_m = 0.0 if away_from is None else away_m
    for _ in range(_MAX_TRIES // 50):
        candidates = rng.uniform(low, high, (50, 2))
        room = clearances_m(plan, candidates, clearance_m)
        found = _choose(candidates, room, clearance_m, apart_m, from_x, from_y, away_m, chosen, found)
        if found == count:
            return chosen
    raise ValueError(
        f"no room for {count} places in {area} with {clearance_m} m to things and {apart_m} m to each other: "
        f"found {found} in {_MAX_TRIES} tries"
    )


@kernel
def _search(free, start, goal, parent):
    """Dijkstra on an 8-connected grid from `start` to `goal` (flat indices); True when there is a way."""
    rows, cols = free.shape
    cost = np.full(rows * cols, np.inf)
    cost[start] = 0.0
    queue = [(0.0, start)]
    while len(queue) > 0:
        so_far, cell = heapq.heappop(queue)
        if cell == goal:
            return True
        if so_far > cost[cell]:
            continue
        row, col = cell // cols, cell % cols
        for d_row in range(-1, 2):
            for d_col in range(-1, 2):
                r, c = row + d_row, col + d_col
                if (d_row == 0 and d_col == 0) or r < 0 or c < 0 or r >= rows or c >= cols or not free[r, c]:
                    continue
                total = so_far + math.sqrt(float(d_row * d_row + d_col * d_col))
                if total < cost[r * cols + c] - 1e-9:
                    cost[r * cols + c] = total
                    parent[r * cols + c] = cell
                    heapq.heappush(queue, (total, r * cols + c))
    return False


def clear_path(
    plan: FloorPlan,
    start: tuple[float, float],
    goal: tuple[float, float],
    area: Area,
    clearance_m: float,
    cell_m: float = 0.1,
    ground: Ground | None = None,
) -> Float[np.ndarray, "N 2"] | None:
    """The shortest way from start to goal over grid cells that are `clearance_m` from things; None without one."""
    xs = np.arange(area[0] + cell_m / 2, area[2], cell_m)
    ys = np.arange(area[1] + cell_m / 2, area[3], cell_m)
    grid = np.stack(np.meshgrid(xs, ys, indexing="ij"), axis=-1).reshape(-1, 2)
    free = clearance_grid_m(plan, area, cell_m, clearance_m) >= clearance_m
    if ground is not None:
        free &= ground(grid).reshape(free.shape)

    def cell_of(point: tuple[float, float]) -> int:
        row = int(np.clip((point[0] - area[0]) / cell_m, 0, len(xs) - 1))
        col = int(np.clip((point[1] - area[1]) / cell_m, 0, len(ys) - 1))
        return row * len(ys) + col

    first, last = cell_of(start), cell_of(goal)
    if not (free.flat[first] and free.flat[last]):
        return None
    parent = np.full(free.size, -1, np.int64)
    if not _search(free, first, last, parent):
        return None
    path = [last]
    while path[-1] != first:
        path.append(int(parent[path[-1]]))
    return np.vstack([start, grid[path[::-1]][1:-1], goal])


def points_along(path: Float[np.ndarray, "N 2"], spacing_m: float) -> Float[np.ndarray, "W 2"]:
    """Points every `spacing_m` along a path, its two ends left out."""
    lengths = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))])
    at = np.arange(spacing_m, lengths[-1] - spacing_m / 2, spacing_m)
    return np.stack([np.interp(at, lengths, path[:, 0]), np.interp(at, lengths, path[:, 1])], axis=1)
