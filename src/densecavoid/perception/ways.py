"""How far it is to the goal from everywhere around the robot, past what stands and who stands still: kernels."""

from __future__ import annotations

import math
from typing import NamedTuple

from densecavoid.sim._jit import inner, kernel

BLOCKED_SLOWER = 40.0
"""Times, through what seems taken: the way is then long, but there always is one."""
_FAR_M = 1e6
_SWEEPS = 16


class WayRules(NamedTuple):
    """What a way keeps from."""

    thing_m: float
    """The robot's centre can be no nearer to what stands,"""
    body_m: float
    """nor to the body of somebody."""
    near_m: float
    """Nearer than this beyond that a metre takes longer,"""
    near_slower: float
    """by up to so many times, the less the farther away (squared)."""
    standing_m_s: float
    """Who is slower stands; who walks will be elsewhere."""
    cells: int
    """Along each side of the square grid around the robot,"""
    cell_m: float


@kernel
def spread_distances(distance, slowness, known, cell):
    """Lengths of the shortest ways on a grid by fast sweeping of the eikonal equation (Zhao, Math. Comp. 74, 2005).

    Args:
        distance: f64 [X, Y]; where `known` it stays, elsewhere it must come in greater than any way, and is lowered.
        slowness: f64 [X, Y] cost of a metre.
        known: bool [X, Y].
        cell: side of a cell, m.
    """
    rows, columns = distance.shape
    for sweep in range(_SWEEPS):
        change = 0.0
        for from_i in range(rows):
            i = from_i if sweep & 1 == 0 else rows - 1 - from_i
            for from_j in range(columns):
                j = from_j if sweep & 2 == 0 else columns - 1 - from_j
                if known[i, j]:
                    continue
                a = min(distance[max(i - 1, 0), j], distance[min(i + 1, rows - 1), j])
                b = min(distance[i, max(j - 1, 0)], distance[i, min(j + 1, columns - 1)])
                step = slowness[i, j] * cell
                value = min(a, b) + step
                if abs(a - b) < step:
                    value = 0.5 * (a + b + math.sqrt(2.0 * step * step - (a - b) * (a - b)))
                if value < distance[i, j]:
                    change = max(change, distance[i, j] - value)
                    distance[i, j] = value
        if sweep >= 3 and change < 0.1 * cell:
            break


@inner
def raise_around(grid, x, y, hit, reach, inside, beside, x0, y0, cell):
    """Raises the cells [X, Y] whose middles are nearer to a point than `hit` to `inside`, which is more than `beside`,
    and those nearer than `reach` to what falls from that to nothing, as the square of what is left of the way."""
    per_m, hit2 = 1.0 / (reach - hit), hit * hit
    first_i, last_i = max(int((x - reach - x0) / cell), 0), min(int((x + reach - x0) / cell) + 1, grid.shape[0])
    first_j, last_j = max(int((y - reach - y0) / cell), 0), min(int((y + reach - y0) / cell) + 1, grid.shape[1])
    for i in range(first_i, last_i):
        off_x, row = x0 + (i + 0.5) * cell - x, grid[i, first_j:]
        for n in range(last_j - first_j):  # without branches: a loop of vectors
            off_y = y0 + (first_j + n + 0.5) * cell - y
            square = off_x * off_x + off_y * off_y
            left = max(reach - math.sqrt(square), 0.0) * per_m
            row[n] = max(row[n], inside if square < hit2 else beside * left * left)


@inner
def _slow_around(slowness, x, y, hit, corner, rules):
    """Makes the cells [C, C] slower that are nearer to a point than `hit`, and beside that."""
    reach, beside = hit + rules.near_m, rules.near_slower
    raise_around(slowness, x, y, hit, reach, BLOCKED_SLOWER, beside, corner, corner, rules.cell_m)


@inner
def find_ways(distance, slowness, known, goal_x, goal_y, points, pos, vel, radius, there, rules):
    """Length of the way to the goal from each cell of a grid around the robot, in its frame.

    Args:
        distance, slowness: f64 [C, C], written; the middle of cell (i, j) is at ((i + .5, j + .5) - C / 2) `cell_m`.
        known: bool [C, C] room to work; then the cells beside the goal, or all at the edge if it is not within.
        goal_x, goal_y: m.
        points: f32 [N, 2] of what stands.
        pos, vel, radius, there: f64 [P, 2], [P, 2], [P], bool [P] people.
        rules: a `WayRules`.
    """
    cells, cell = rules.cells, rules.cell_m
    corner = -0.5 * cells * cell
    for i in range(cells):
        for j in range(cells):
            slowness[i, j], known[i, j], distance[i, j] = 0.0, False, _FAR_M
    for n in range(points.shape[0]):
        _slow_around(slowness, points[n, 0], points[n, 1], rules.thing_m, corner, rules)
    for p in range(there.shape[0]):
        if there[p] and math.hypot(vel[p, 0], vel[p, 1]) < rules.standing_m_s:
            _slow_around(slowness, pos[p, 0], pos[p, 1], rules.body_m + radius[p], corner, rules)
    goal_i, goal_j = math.floor((goal_x - corner) / cell), math.floor((goal_y - corner) / cell)
    inside = 1 <= goal_i < cells - 1 and 1 <= goal_j < cells - 1
    for i in range(cells):
        for j in range(cells):
            slowness[i, j] += 1.0
            at_edge = i == 0 or j == 0 or i == cells - 1 or j == cells - 1
            if (inside and abs(i - goal_i) <= 1 and abs(j - goal_j) <= 1) or (not inside and at_edge):
                known[i, j] = True
                distance[i, j] = math.hypot(corner + (i + 0.5) * cell - goal_x, corner + (j + 0.5) * cell - goal_y)
    spread_distances(distance, slowness, known, cell)
