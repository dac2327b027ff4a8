"""Search over place, heading and time: the quickest way among people whose whole future is known.

All states that the robot can be in after 0, .4, .8, ... s are kept, one for each cell of place and heading, with their
exact poses; from each it goes on by one of a few commands held for .4 s. So a way that is found can be driven as it is.
Kernels here call only what is in this file and in `sim`, whose sources name numba's cache.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from densecavoid.sim._jit import inner, kernel
from densecavoid.sim.geometry import mark_disc
from densecavoid.sim.robot import drive

CELL_M = 0.05
"""Of the grids of distances: what is surely free, surely not, or to be computed exactly."""

_HALF_DIAGONAL = CELL_M * math.sqrt(0.5)

COMMANDS = np.array(
    [
        *((1.0, turn) for turn in (0.0, 0.5, -0.5, 1.0, -1.0)),
        *((speed, turn) for speed in (0.6, 0.3) for turn in (0.0, 1.0, -1.0)),
        *((0.0, turn) for turn in (1.0, -1.0, 0.0)),
    ]
)
"""Linear and angular velocity as shares of the robot's greatest; of two that lead to one cell the first is kept."""


class Ground(NamedTuple):
    """What stands still, on a grid of `CELL_M`."""

    x0: float
    y0: float
    clearance: np.ndarray  # f32 [X, Y] from each cell's centre to the nearest thing, up to a limit
    to_goal: np.ndarray  # f32 [X, Y] length of the shortest way to the goal, inf where there is none


class Rules(NamedTuple):
    """The robot, its clock and what ends an episode."""

    collision_m: float
    goal_m: float
    max_linear: float
    max_angular: float
    dt_s: float
    steps: int
    """Physics steps for which a command is held."""
    max_steps: int
    """Physics steps until time is up."""


@inner
def _eikonal(a, b, cell):
    """Distance at a cell from the smaller distances of its neighbours along x and y (|grad d| = 1)."""
    if abs(a - b) >= cell:
        return min(a, b) + cell
    return 0.5 * (a + b + math.sqrt(2.0 * cell * cell - (a - b) * (a - b)))


@kernel
def shortest_ways(free, goal_i, goal_j, cell):
    """Length of the shortest way from each free cell to the goal's cell (fast sweeping, Zhao 2005), inf elsewhere."""
    rows, columns = free.shape
    out = np.full((rows, columns), np.inf)
    out[goal_i, goal_j] = 0.0
    changed = True
    while changed:
        changed = False
        for sweep in range(4):
            for ii in range(rows):
                i = ii if sweep % 2 == 0 else rows - 1 - ii
                for jj in range(columns):
                    j = jj if sweep < 2 else columns - 1 - jj
                    if not free[i, j]:
                        continue
                    a = min(out[i - 1, j] if i > 0 else np.inf, out[i + 1, j] if i + 1 < rows else np.inf)
                    b = min(out[i, j - 1] if j > 0 else np.inf, out[i, j + 1] if j + 1 < columns else np.inf)
                    if a == np.inf and b == np.inf:
                        continue
                    distance = _eikonal(a, b, cell)
                    if distance < out[i, j] - 1e-3 * cell:
                        out[i, j] = distance
                        changed = True
    return out


@inner
def _is_free(x, y, ground, blocked, bodies, t, collision_m):
    """Whether the robot may be at a place at instant t of `bodies` [T, N, 3], whose cells `blocked` has."""
    i, j = int((x - ground.x0) / CELL_M), int((y - ground.y0) / CELL_M)
    if x < ground.x0 or y < ground.y0 or i >= blocked.shape[0] or j >= blocked.shape[1]:
        return False
    off_x, off_y = x - (ground.x0 + (i + 0.5) * CELL_M), y - (ground.y0 + (j + 0.5) * CELL_M)
    # Distances change no faster than the place does.
    if ground.clearance[i, j] - math.sqrt(off_x * off_x + off_y * off_y) < collision_m or blocked[i, j] == 1:
        return False
    if blocked[i, j] == 2:
        for n in range(bodies.shape[1]):
            off_x, off_y, reach = x - bodies[t, n, 0], y - bodies[t, n, 1], bodies[t, n, 2] + collision_m
            if bodies[t, n, 2] > 0.0 and off_x * off_x + off_y * off_y < reach * reach:
                return False
    return True


@inner
def _way_left(x, y, ground):
    i, j = int((x - ground.x0) / CELL_M), int((y - ground.y0) / CELL_M)
    if x < ground.x0 or y < ground.y0 or i >= ground.to_goal.shape[0] or j >= ground.to_goal.shape[1]:
        return np.inf
    return ground.to_goal[i, j]


@kernel
def search(start, goal, bodies, stay, ground, rules, commands, cell_m, headings, window_m):
    """The quickest way to the goal.

    Args:
        start: f64 [3] pose.
        goal: f64 [2].
        bodies: f32 [T, N, 3] x, y, radius of people's cylinders after each physics step.
        stay: whether people are after T as they are at T; otherwise nobody is left then.
        ground, rules: see there.
        commands: f64 [C, 2] m/s, rad/s.
        cell_m: One state is kept for each square of this side,
        headings: and each of so many headings.
        window_m: States whose way to the goal is longer than the shortest by more than this are given up.

    Returns:
        (numbers of the commands i64 [L], physics steps until the goal is reached); of no length and -1 without a way.
    """
    rows = int(ground.clearance.shape[0] * CELL_M / cell_m) + 1
    columns = int(ground.clearance.shape[1] * CELL_M / cell_m) + 1
    taken = np.full((rows, columns, headings), -1, np.int32)
    blocked = np.zeros((rules.steps, *ground.clearance.shape), np.uint8)
    layers = rules.max_steps // rules.steps
    parent, command, size = np.zeros(65536, np.int32), np.zeros(65536, np.uint8), 1
    states = np.zeros((1, 3))
    states[0] = start
    first = 0  # of the present layer among all states
    pose, ends = np.zeros(3), np.zeros((commands.shape[0], 3))
    for c in range(commands.shape[0]):
        drive(ends[c], commands[c, 0], commands[c, 1], rules.steps * rules.dt_s)
    found_at, found, found_by = rules.max_steps + 1, -1, -1
    for layer in range(layers):
        before = layer * rules.steps
        blocked[:] = 0
        for k in range(rules.steps):
            t = before + k
            if t >= bodies.shape[0] and (not stay or bodies.shape[0] == 0):
                continue
            seen = min(t, bodies.shape[0] - 1)
            for n in range(bodies.shape[1]):
                x, y, radius = bodies[seen, n, 0], bodies[seen, n, 1], bodies[seen, n, 2]
                if radius > 0.0:
                    # What the disc covers wholly is surely not free, what it covers in part has to be computed.
                    inside = max(radius + rules.collision_m - _HALF_DIAGONAL, 0.0)
                    reach = radius + rules.collision_m + _HALF_DIAGONAL
                    mark_disc(blocked[k], x, y, inside, reach, ground.x0, ground.y0, CELL_M)
        following = np.empty((4096, 3))
        count = 0
        time_left = (rules.max_steps - before - rules.steps) * rules.dt_s
        nearest = np.inf
        for s in range(states.shape[0]):
            nearest = min(nearest, _way_left(states[s, 0], states[s, 1], ground))
        for s in range(states.shape[0]):
            if _way_left(states[s, 0], states[s, 1], ground) > nearest + window_m:
                continue
            cos, sin = math.cos(states[s, 2]), math.sin(states[s, 2])
            for c in range(commands.shape[0]):
                linear, angular = commands[c, 0], commands[c, 1]
                # Where it ends, to see first whether another state is there already.
                x = states[s, 0] + cos * ends[c, 0] - sin * ends[c, 1]
                y = states[s, 1] + sin * ends[c, 0] + cos * ends[c, 1]
                i, j = int((x - ground.x0) / cell_m), int((y - ground.y0) / cell_m)
                turn = (states[s, 2] + ends[c, 2] + math.pi) / (2.0 * math.pi)
                h = int((turn + 1.0) * headings + 0.5) % headings
                if x < ground.x0 or y < ground.y0 or i >= rows or j >= columns or taken[i, j, h] == layer:
                    continue
                if 0.95 * _way_left(x, y, ground) - rules.goal_m > time_left * rules.max_linear + 0.4:
                    continue
                pose[0], pose[1], pose[2] = states[s, 0], states[s, 1], states[s, 2]
                free = True
                for k in range(rules.steps):
                    drive(pose, linear, angular, rules.dt_s)
                    t = before + k
                    seen = min(t, bodies.shape[0] - 1)
                    if not _is_free(pose[0], pose[1], ground, blocked[k], bodies, seen, rules.collision_m):
                        free = False
                        break
                    off_x, off_y = goal[0] - pose[0], goal[1] - pose[1]
                    if off_x * off_x + off_y * off_y < rules.goal_m * rules.goal_m:
                        if t + 1 < found_at:
                            found_at, found, found_by = t + 1, first + s, c
                        break
                if not free:
                    continue
                taken[i, j, h] = layer
                if count == following.shape[0]:
                    larger = np.empty((2 * count, 3))
                    larger[:count] = following
                    following = larger
                following[count, 0], following[count, 1], following[count, 2] = pose[0], pose[1], pose[2]
                count += 1
                if size == parent.shape[0]:
                    more_parents, more_commands = np.zeros(2 * size, np.int32), np.zeros(2 * size, np.uint8)
                    more_parents[:size], more_commands[:size] = parent, command
                    parent, command = more_parents, more_commands
                parent[size], command[size] = first + s, c
                size += 1
        if found >= 0:
            way = np.empty(layer + 1, np.int64)
            way[layer] = found_by
            for k in range(layer - 1, -1, -1):
                way[k] = command[found]
                found = parent[found]
            return way, found_at
        if count == 0:
            break
        first = size - count
        states = following[:count]
    return np.empty(0, np.int64), -1
