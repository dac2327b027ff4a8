"""Free space in a floor plan: how far places are from things, random free places, and the shortest clear path."""

from __future__ import annotations

import heapq
import math

import numpy as np
from jaxtyping import Float

from densecavoid.sim._jit import kernel
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.geometry import (
    BOX_HALF_LENGTH,
    BOX_HALF_WIDTH,
    BOX_X,
    BOX_Y,
    disc_offset,
    rectangle_offset,
)
from densecavoid.sim.mesh import mesh_set, place_rows
from densecavoid.sim.mesh_contact import PERSON_TOP_M, lessen_clearances

Area = tuple[float, float, float, float]
"""x_min, y_min, x_max, y_max."""

_MAX_TRIES = 2000


@kernel
def _clearances(points, boxes, cylinders, limit, out):
    for n in range(points.shape[0]):
        x, y = points[n, 0], points[n, 1]
        nearest = limit
        for k in range(boxes.shape[0]):
            box = boxes[k]
            reach = box[BOX_HALF_LENGTH] + box[BOX_HALF_WIDTH] + nearest
            if abs(x - box[BOX_X]) > reach or abs(y - box[BOX_Y]) > reach:
                continue
            distance, _, _ = rectangle_offset(x, y, box)
            nearest = min(nearest, distance)
        for k in range(cylinders.shape[0]):
            distance, _, _ = disc_offset(x, y, cylinders[k])
            nearest = min(nearest, distance)
        out[n] = nearest


def clearances_m(plan: FloorPlan, points: Float[np.ndarray, "N 2"], limit_m: float = 10.0) -> Float[np.ndarray, "N"]:
    """Distance from each point to the nearest thing in the plan (negative inside); at most `limit_m`."""
    packed = plan.packed()
    out = np.empty(len(points))
    points = np.asarray(points, np.float64)
    _clearances(points, packed.boxes, packed.cylinders, limit_m, out)
    if plan.meshes:
        meshes = tuple(dict.fromkeys(place.mesh for place in plan.meshes))
        places = place_rows(plan.meshes, [meshes.index(place.mesh) for place in plan.meshes])
        lessen_clearances(points, PERSON_TOP_M, places, mesh_set(meshes), out)
    return out


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
    chosen = np.zeros((0, 2))
    low, high = np.array(area[:2]), np.array(area[2:])
    for _ in range(_MAX_TRIES // 50):
        candidates = rng.uniform(low, high, (50, 2))
        fits = clearances_m(plan, candidates) >= clearance_m
        if away_from is not None:
            fits &= np.hypot(*(candidates - away_from).T) >= away_m
        for point in candidates[fits]:
            if len(chosen) < count and (np.hypot(*(chosen - point).T) >= apart_m).all():
                chosen = np.vstack([chosen, point])
        if len(chosen) >= count:
            return chosen
    raise ValueError(
        f"no room for {count} places in {area} with {clearance_m} m to things and {apart_m} m to each other: "
        f"found {len(chosen)} in {_MAX_TRIES} tries"
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
) -> Float[np.ndarray, "N 2"] | None:
    """The shortest way from start to goal over grid cells that are `clearance_m` from things; None without one."""
    xs = np.arange(area[0] + cell_m / 2, area[2], cell_m)
    ys = np.arange(area[1] + cell_m / 2, area[3], cell_m)
    grid = np.stack(np.meshgrid(xs, ys, indexing="ij"), axis=-1).reshape(-1, 2)
    free = (clearances_m(plan, grid, limit_m=clearance_m) >= clearance_m).reshape(len(xs), len(ys))

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
