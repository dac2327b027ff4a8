"""Dynamic programming over place, heading and the next seconds in the robot's frame: the loops of `lookahead`.

The window lies ahead of the robot: it cannot reverse, so that within the horizon nothing behind it can be reached.
Values are those of `foresight.value_field`: 1 at the goal, a little less for each moment until then.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from densecavoid.perception.ways import WayRules, find_ways, raise_around
from densecavoid.sim._jit import inner, kernel
from densecavoid.sim.robot import drive

FRAME = 6
"""Cells around the window; a robot moves less far in a moment."""
_TAKEN = np.float32(1e3)
_TURNED_ROUND = 0.6  # share of the time to turn on the spot that heading elsewhere costs: robots drive on as they turn


class Rules(NamedTuple):
    """`LookaheadConfig` and the robot as the kernels read them."""

    cell_m: float
    moments: int
    hold_s: float
    discount: float  # of a moment
    slip: float
    collision: float
    body_m: float
    margin_m: float
    near_person_m: float
    near_person_cost: float
    near_thing_m: float
    near_thing_slower: float
    beyond_slower: float
    doubt_m_s: float
    goal_m: float
    ways: WayRules  # beyond the window
    max_linear: float
    max_angular: float


class Around(NamedTuple):
    """What is known around each robot, in its frame."""

    goal: np.ndarray  # f64 [B, 2]
    points: np.ndarray  # f32 [B, N, 2] of what stands,
    num_points: np.ndarray  # i64 [B] so many
    pos: np.ndarray  # f64 [B, P, 2] people,
    vel: np.ndarray  # f64 [B, P, 2] over ground,
    radius: np.ndarray  # f64 [B, P],
    there: np.ndarray  # bool [B, P] if they are


@inner
def _end_values(values, ground, distance, fade, b, around, rules, x0, y0):
    """Values [H, X, Y] of having got somewhere when the horizon ends, by the way that is left and the turn to it.

    Args:
        ground: f32 [X, Y] cost of being in a cell.
        distance: of the map's cells.
        fade: f32 [H] room to work.
        x0, y0: corner of the window.
    """
    headings, cells, cell = values.shape[0], rules.ways.cells, rules.ways.cell_m
    corner = -0.5 * cells * cell
    per_s = rules.beyond_slower * math.log(rules.discount) / rules.hold_s
    for h in range(headings):
        off = min(h, headings - h) * 2.0 * math.pi / headings
        fade[h] = math.exp(per_s * _TURNED_ROUND * off / rules.max_angular)
    for i in range(ground.shape[0]):
        for j in range(ground.shape[1]):
            x, y = x0 + (i + 0.5) * rules.cell_m, y0 + (j + 0.5) * rules.cell_m
            u, v = (x - corner) / cell - 0.5, (y - corner) / cell - 0.5
            at_i, at_j = min(max(int(u), 0), cells - 2), min(max(int(v), 0), cells - 2)
            u, v = u - at_i, v - at_j
            near, far = distance[at_i], distance[at_i + 1]
            length = (1.0 - u) * ((1.0 - v) * near[at_j] + v * near[at_j + 1])
            length += u * ((1.0 - v) * far[at_j] + v * far[at_j + 1])
            towards_x = (1.0 - v) * (near[at_j] - far[at_j]) + v * (near[at_j + 1] - far[at_j + 1])
            towards_y = (1.0 - u) * (near[at_j] - near[at_j + 1]) + u * (far[at_j] - far[at_j + 1])
            ahead = round(math.atan2(towards_y, towards_x) / (2.0 * math.pi) * headings)
            value = np.float32(math.exp(per_s * length / rules.max_linear))
            off_x, off_y = x - around.goal[b, 0], y - around.goal[b, 1]
            if off_x * off_x + off_y * off_y < rules.goal_m * rules.goal_m:
                for h in range(headings):
                    values[h, i, j] = np.float32(1.0)
            elif ground[i, j] >= _TAKEN:
                for h in range(headings):
                    values[h, i, j] = np.float32(rules.collision)
            else:
                for h in range(headings):
                    values[h, i, j] = value * fade[(h - ahead) % headings]


@kernel
def _one_moment_before(now, following, best, total, steps, cost, kept, is_goal, box, turned, rules):
    """Values [H, X, Y] a moment earlier, in the cells and headings that can be reached by then.

    Args:
        following: a moment later.
        best, total: f32 [Y] room to work.
        steps: f64 [H, C, 3] of `field_kernels.steps_of_commands`.
        cost: f32 [X, Y] of being in a cell then.
        kept: f32 [X, Y] what is left of a cell's value because things are near.
        is_goal: bool [X, Y].
        box: first and last cells (excluded) along x and y.
        turned: headings that can be reached to either side.
    """
    headings, commands = steps.shape[0], steps.shape[1]
    meant = np.float32(rules.discount * (1.0 - rules.slip))
    spread = np.float32(rules.discount * rules.slip / commands)
    collision = np.float32(rules.collision)
    first_i, last_i, first_j, last_j = box
    size = last_j - first_j
    for h_ahead in range(-turned, turned + 1):
        h = h_ahead % headings
        for i in range(first_i, last_i):
            for j in range(size):
                best[j] = np.float32(-2.0)
                total[j] = np.float32(0.0)
            for c in range(commands):
                ahead_i, ahead_j, later = steps[h, c, 0], steps[h, c, 1], following[int(steps[h, c, 2])]
                i0, j0 = math.floor(ahead_i), math.floor(ahead_j)
                u, v = ahead_i - i0, ahead_j - j0
                w00, w01 = np.float32((1.0 - u) * (1.0 - v)), np.float32((1.0 - u) * v)
                w10, w11 = np.float32(u * (1.0 - v)), np.float32(u * v)
                # Slices that begin at 0: the loop over them is one of vectors.
                near, far = later[i + i0, first_j + j0 :], later[i + i0 + 1, first_j + j0 :]
                for j in range(size):
                    value = w00 * near[j] + w01 * near[j + 1] + w10 * far[j] + w11 * far[j + 1]
                    best[j] = max(best[j], value)
                    total[j] += value
            row, row_cost, row_goal = now[h, i, first_j:], cost[i, first_j:], is_goal[i, first_j:]
            row_kept = kept[i, first_j:]
            for j in range(size):
                value = (meant * best[j] + spread * total[j]) * row_kept[j] - row_cost[j]
                value = collision if row_cost[j] >= _TAKEN else value
                row[j] = np.float32(1.0) if row_goal[j] else value


@inner
def _too_near(x, y, time_s, b, around, rules):
    """What it costs to be at a place then: up to what a collision does, from a tenth of a metre beyond one."""
    worst = 0.0
    for p in range(around.there.shape[1]):
        if around.there[b, p]:
            off_x = around.pos[b, p, 0] + time_s * around.vel[b, p, 0] - x
            off_y = around.pos[b, p, 1] + time_s * around.vel[b, p, 1] - y
            free = math.sqrt(off_x * off_x + off_y * off_y) - around.radius[b, p] - rules.body_m
            worst = max(worst, 1.0 - free / 0.1)
    return -rules.collision * min(worst, 1.0)


@kernel
def worth_of_commands(first, last, around, steps, commands, boxes, shape, rules, out):
    """What it is worth to hold each command for a moment, and then to do the best that can be foreseen.

    Args:
        around: an `Around`.
        steps: f64 [H, C, 3] as `field_kernels.steps_of_commands` gives them for headings counted from the robot's.
        commands: f64 [K, 2] m/s, rad/s.
        boxes: i64 [M, 5] of each moment: first and last cells (excluded) along x and y that the robot can be in, and
            headings that it can have turned.
        shape: cells of the window along x and y with its frame, and cells behind and right of the robot.
        rules: a `Rules`.
        out: f64 [B, K], written.
    """
    headings, (size_x, size_y, behind, right) = steps.shape[0], shape
    x0, y0, cell = -behind * rules.cell_m, -right * rules.cell_m, rules.cell_m
    one, other = np.zeros((headings, size_x, size_y), np.float32), np.zeros((headings, size_x, size_y), np.float32)
    ground, cost = np.zeros((size_x, size_y), np.float32), np.zeros((size_x, size_y), np.float32)
    kept = np.zeros((size_x, size_y), np.float32)
    best, total, fade = np.zeros(size_y, np.float32), np.zeros(size_y, np.float32), np.zeros(headings, np.float32)
    is_goal = np.zeros((size_x, size_y), np.bool_)
    cells = rules.ways.cells
    distance, slowness, known = np.zeros((cells, cells)), np.zeros((cells, cells)), np.zeros((cells, cells), np.bool_)
    pose = np.zeros(3)
    for b in range(first, last):
        goal_x, goal_y = around.goal[b, 0], around.goal[b, 1]
        seen = around.points[b, : around.num_points[b]]
        people = around.pos[b], around.vel[b], around.radius[b], around.there[b]
        find_ways(distance, slowness, known, goal_x, goal_y, seen, *people, rules.ways)
        ground[:] = 0.0
        hit = rules.body_m + rules.margin_m
        for n in range(around.num_points[b]):
            x, y = around.points[b, n, 0], around.points[b, n, 1]
            raise_around(ground, x, y, hit, hit + rules.near_thing_m, _TAKEN, rules.near_thing_slower, x0, y0, cell)
        for i in range(size_x):
            for j in range(size_y):
                off_x = x0 + (i + 0.5) * cell - around.goal[b, 0]
                off_y = y0 + (j + 0.5) * cell - around.goal[b, 1]
                is_goal[i, j] = off_x * off_x + off_y * off_y < rules.goal_m * rules.goal_m
                kept[i, j] = 1.0
                if ground[i, j] < _TAKEN:
                    kept[i, j] = rules.discount ** ground[i, j]
                    ground[i, j] = 0.0
        _end_values(one, ground, distance, fade, b, around, rules, x0, y0)
        other[:] = one
        following, now = one, other
        for k in range(rules.moments - 1, 0, -1):
            cost[:] = ground
            time_s = k * rules.hold_s
            for p in range(around.there.shape[1]):
                if around.there[b, p]:
                    x = around.pos[b, p, 0] + time_s * around.vel[b, p, 0]
                    y = around.pos[b, p, 1] + time_s * around.vel[b, p, 1]
                    reach = around.radius[b, p] + rules.body_m + rules.margin_m
                    beside = reach + rules.near_person_m + rules.doubt_m_s * time_s
                    raise_around(cost, x, y, reach, beside, _TAKEN, rules.near_person_cost, x0, y0, cell)
            box = (boxes[k, 0], boxes[k, 1], boxes[k, 2], boxes[k, 3])
            _one_moment_before(now, following, best, total, steps, cost, kept, is_goal, box, boxes[k, 4], rules)
            following, now = now, following
        for c in range(commands.shape[0]):
            pose[0] = pose[1] = pose[2] = 0.0
            lost = 0.0
            for half in range(1, 3):
                drive(pose, commands[c, 0], commands[c, 1], 0.5 * rules.hold_s)
                lost = max(lost, _too_near(pose[0], pose[1], 0.5 * half * rules.hold_s, b, around, rules))
            u, v = (pose[0] - x0) / cell - 0.5, (pose[1] - y0) / cell - 0.5
            i, j, turn = int(u), int(v), pose[2] / (2.0 * math.pi) * headings
            u, v, h = u - i, v - j, math.floor(turn)
            value = 0.0
            for turned in range(2):
                share, later = turn - h if turned else 1.0 - turn + h, following[(h + turned) % headings]
                value += share * (1.0 - u) * ((1.0 - v) * later[i, j] + v * later[i, j + 1])
                value += share * u * ((1.0 - v) * later[i + 1, j] + v * later[i + 1, j + 1])
            out[b, c] = value - lost
