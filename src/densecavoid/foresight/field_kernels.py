"""Dynamic programming over place, heading and time, and looking up its result: the loops of `value_field`.

Grids are [headings, x, y], framed by `FRAME` cells of collision, so that no step leaves them. Kernels here call only
what is in this file and in `sim`, whose sources name numba's cache.
"""

from __future__ import annotations

import math

import numpy as np

from densecavoid.sim._jit import inner, kernel
from densecavoid.sim.geometry import mark_disc
from densecavoid.sim.robot import drive

FRAME = 6
"""Cells; a robot moves less far in a step."""
SPEEDS, TURNS = (1.0, 0.5, 0.0), (0.0, 1.0, -1.0)
"""Commands that the programme weighs, as shares of the robot's greatest."""
STEPS_OF_SCALE = 32000.0
"""Values from -1 to 1 are kept as 16-bit integers."""

FREE, BLOCKED, GOAL = 0, 1, 2
"""What a cell is."""
NEAR = 2
"""What a cell beside a person is; `BLOCKED` where the robot would hit them."""


@kernel
def steps_of_commands(commands, headings, hold_s, cell):
    """Where each command [C, 3] (m/s, rad/s, headings turned) leads from each heading when it is held: [H, C, 3] cells
    along x and y, and the heading that follows.
    """
    steps, pose = np.zeros((headings, commands.shape[0], 3)), np.zeros(3)
    for h in range(headings):
        for c in range(commands.shape[0]):
            pose[0], pose[1], pose[2] = 0.0, 0.0, 2.0 * math.pi * h / headings
            drive(pose, commands[c, 0], commands[c, 1], hold_s)
            steps[h, c, 0], steps[h, c, 1] = pose[0] / cell, pose[1] / cell
            steps[h, c, 2] = (h + int(commands[c, 2])) % headings
    return steps


def steps_of_moments(max_linear, max_angular, hold_s, cell):
    """Where each of `SPEEDS` and `TURNS` leads a robot with these limits (m/s, rad/s) from each heading in a moment, as
    `steps_of_commands`. A full turn is as many moments as there are headings, nearly: an even number of them."""
    headings = 2 * max(2, round(math.pi / (max_angular * hold_s)))
    turn = 2.0 * math.pi / headings
    commands = [(v * max_linear, w * turn / hold_s, w) for v in SPEEDS for w in TURNS]
    return steps_of_commands(np.array(commands), headings, hold_s, cell)


@kernel
def back_up(following, best, total, steps):
    """For all states, the best of the values that commands lead to, and their sum.

    Args:
        following: f32 [H, X, Y] values a step later.
        best, total: f32 [H, X, Y], overwritten.
        steps: f64 [H, C, 3] along x and y (cells), and the heading that follows; of each heading and command.
    """
    headings, rows, columns = following.shape[0], following.shape[1], following.shape[2]
    for h in range(headings):
        for i in range(FRAME, rows - FRAME):
            for j in range(FRAME, columns - FRAME):
                best[h, i, j] = np.float32(-2.0)
                total[h, i, j] = np.float32(0.0)
        for c in range(steps.shape[1]):
            ahead_i, ahead_j, later = steps[h, c, 0], steps[h, c, 1], following[int(steps[h, c, 2])]
            i0, j0 = math.floor(ahead_i), math.floor(ahead_j)
            u, v = ahead_i - i0, ahead_j - j0
            w00, w01 = np.float32((1.0 - u) * (1.0 - v)), np.float32((1.0 - u) * v)
            w10, w11 = np.float32(u * (1.0 - v)), np.float32(u * v)
            for i in range(FRAME, rows - FRAME):
                near, far = later[i + i0], later[i + i0 + 1]
                row_best, row_total = best[h, i], total[h, i]
                for j in range(FRAME, columns - FRAME):
                    value = w00 * near[j + j0] + w01 * near[j + j0 + 1] + w10 * far[j + j0] + w11 * far[j + j0 + 1]
                    row_best[j] = max(row_best[j], value)
                    row_total[j] += value


@kernel
def settle(values, best, total, ground, cost, people, num_commands, discount, slip, collision, near_cost):
    """Values [H, X, Y] from what commands lead to; returns the greatest change.

    Args:
        ground: u8 [X, Y] `FREE`, `BLOCKED` or `GOAL`.
        cost: f32 [X, Y] of a step there.
        people: u8 [X, Y] `FREE`, `NEAR` or `BLOCKED`.
        discount, slip, collision, near_cost: as in `FieldConfig`, a step.
    """
    change = np.float32(0.0)
    kept, spread = np.float32(discount * (1.0 - slip)), np.float32(discount * slip / num_commands)
    for h in range(values.shape[0]):
        for i in range(ground.shape[0]):
            for j in range(ground.shape[1]):
                at_i, at_j = i + FRAME, j + FRAME
                if ground[i, j] == BLOCKED or people[i, j] == BLOCKED:
                    value = np.float32(collision)
                elif ground[i, j] == GOAL:
                    value = np.float32(1.0)
                else:
                    value = kept * best[h, at_i, at_j] + spread * total[h, at_i, at_j] - cost[i, j]
                    if people[i, j] == NEAR:
                        value -= np.float32(near_cost)
                change = max(change, abs(value - values[h, at_i, at_j]))
                values[h, at_i, at_j] = value
    return change


@kernel
def mark_people(people, bodies, x0, y0, cell, reach, margin):
    """Marks the cells [X, Y] whose centres are within `reach` of bodies [N, 3] (x, y, radius; 0: not there), or nearly.

    Args:
        x0, y0: corner of the first cell.
        margin: beyond `reach`, for `NEAR`.
    """
    people[:] = FREE
    for n in range(bodies.shape[0]):
        if bodies[n, 2] > 0.0:
            hit = bodies[n, 2] + reach
            mark_disc(people, bodies[n, 0], bodies[n, 1], hit, hit + margin, x0, y0, cell)


@kernel
def keep(kept, values):
    """Values [H, X, Y] without their frame, as 16-bit integers [H / n, X, Y], every n-th heading."""
    every = values.shape[0] // kept.shape[0]
    for h in range(kept.shape[0]):
        for i in range(kept.shape[1]):
            for j in range(kept.shape[2]):
                value = min(max(values[h * every, i + FRAME, j + FRAME], np.float32(-1.0)), np.float32(1.0))
                kept[h, i, j] = np.int16(round(value * STEPS_OF_SCALE))


@inner
def _value_at(flat, shape, grid, outside, x, y, yaw, step):
    """Between cells, headings and moments. `flat` holds many fields; see `values_of_commands`."""
    first, moments, headings, rows, columns = shape[0], shape[1], shape[2], shape[3], shape[4]
    u, v = (x - grid[0]) / grid[2] - 0.5, (y - grid[1]) / grid[2] - 0.5
    if not (0.0 <= u < rows - 1 and 0.0 <= v < columns - 1):
        return outside
    i, j = int(u), int(v)
    u, v = u - i, v - j
    turn = yaw / (2.0 * math.pi)
    turn = (turn - math.floor(turn)) * headings
    h = int(turn)
    turn -= h
    step = min(max(step, 0.0), moments - 1.0)
    k = int(step)
    step -= k
    value = 0.0
    for later in range(2):
        share_k = step if later else 1.0 - step
        if share_k == 0.0:
            continue
        for turned in range(2):
            share = share_k * (turn if turned else 1.0 - turn)
            at = first + ((min(k + later, moments - 1) * headings + (h + turned) % headings) * rows + i) * columns + j
            value += share * (
                (1.0 - u) * ((1.0 - v) * flat[at] + v * flat[at + 1])
                + u * ((1.0 - v) * flat[at + columns] + v * flat[at + columns + 1])
            )
    return value / STEPS_OF_SCALE


@kernel
def values_of_poses(flat, shapes, grids, outside, which, poses, steps, out):
    """Value [B] of being somewhere.

    Args:
        flat: i16 values of all fields, one after the other.
        shapes: i64 [F, 5] where each begins, and its moments, headings, rows and columns.
        grids: f64 [F, 3] corner of the first cell, side of a cell.
        outside: value beyond the grid.
        which: i64 [B] field of each robot.
        poses: f64 [B, 3]
        steps: f64 [B] moments since the start.
        out: f64 [B], written.
    """
    for b in range(len(which)):
        n = which[b]
        out[b] = _value_at(flat, shapes[n], grids[n], outside, poses[b, 0], poses[b, 1], poses[b, 2], steps[b])


@kernel
def values_of_commands(flat, shapes, grids, outside, which, poses, steps, commands, hold_s, out):
    """Value [B, C] of holding each command (m/s, rad/s) for one moment; a collision half way counts as one.

    Args:
        As `values_of_poses`.
        commands: f64 [C, 2]
        hold_s: length of a moment.
        out: f64 [B, C], written.
    """
    pose = np.zeros(3)
    for b in range(len(which)):
        shape, grid = shapes[which[b]], grids[which[b]]
        for c in range(commands.shape[0]):
            pose[0], pose[1], pose[2] = poses[b, 0], poses[b, 1], poses[b, 2]
            value = 0.0
            for half in range(1, 3):
                drive(pose, commands[c, 0], commands[c, 1], hold_s / 2)
                value = _value_at(flat, shape, grid, outside, pose[0], pose[1], pose[2], steps[b] + half / 2)
                # Between the cell that is hit and its neighbours values rise quickly.
                if value < 0.8 * outside:
                    break
            out[b, c] = value
