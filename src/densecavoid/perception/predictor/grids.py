"""What RobustTP looks at: a track's past, and its neighbours' pasts on two grids laid out along its walking direction.

The neighbour grid has 13 rows (track in the seventh) by 3 columns, the horizon grid 7 rows ahead by 3 columns. A cell
holds one neighbour, the nearest to the track. All places are metres from where the track is now, in its direction.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from densecavoid.perception.predictor.contract import Histories
from densecavoid.perception.predictor.features import MIN_SPEED, as_kernels_read, base_velocity
from densecavoid.perception.predictor.kalman import KalmanPredictor
from densecavoid.sim._jit import inner, kernel

NEIGHBOUR_GRID = (13, 3)
HORIZON_GRID = (7, 3)
NEIGHBOUR_CELL_M = 0.8
HORIZON_CELL_M = 1.2
"""Longer, to see farther ahead."""
SLOTS = 10
"""The nearest so many of those on either grid are kept."""
STATE = 5
"""Numbers a step, in the track's own direction: x, y from where it is now (m), vx, vy (m/s), 1 for a place known."""
PAIR = 5
"""Numbers of a neighbour: place ahead and left of the track (m), cosine and sine of its direction against it, 1."""


class GridFeatures(NamedTuple):
    """Inputs of the network, and what its outputs relate to."""

    own: np.ndarray  # f32 [N, H, STATE]
    neighbour: np.ndarray  # i64 [N, SLOTS] row of each neighbour; the track's own where there is none
    pair: np.ndarray  # f32 [N, SLOTS, PAIR] zeros where there is none
    cells: np.ndarray  # f32 [N, SLOTS, 39 + 21] 1 in the cell of each grid that a neighbour holds
    velocity: np.ndarray  # f64 [N, 2] of the constant-velocity line, m/s
    direction: np.ndarray  # f64 [N, 2] cosine and sine of the walking direction


NUM_CELLS = (NEIGHBOUR_GRID[0] * NEIGHBOUR_GRID[1], HORIZON_GRID[0] * HORIZON_GRID[1])


@kernel
def neighbour_cell(ahead, left):
    """Row by row from behind to ahead, and from right to left within a row; -1: off the grid."""
    row = math.floor(ahead / NEIGHBOUR_CELL_M + NEIGHBOUR_GRID[0] / 2)
    column = math.floor(left / NEIGHBOUR_CELL_M + NEIGHBOUR_GRID[1] / 2)
    if row < 0 or row >= NEIGHBOUR_GRID[0] or column < 0 or column >= NEIGHBOUR_GRID[1]:
        return -1
    return row * NEIGHBOUR_GRID[1] + column


@kernel
def horizon_cell(ahead, left):
    """As `neighbour_cell`; the first row begins at the track."""
    row = math.floor(ahead / HORIZON_CELL_M)
    column = math.floor(left / HORIZON_CELL_M + HORIZON_GRID[1] / 2)
    if row < 0 or row >= HORIZON_GRID[0] or column < 0 or column >= HORIZON_GRID[1]:
        return -1
    return row * HORIZON_GRID[1] + column


@inner
def _write_states(own, pos, valid, direction, n, period_s):
    """The history of track n in its own direction. A velocity is that since the place before; 0 without one."""
    last = pos.shape[1] - 1
    cos, sin = direction[n, 0], direction[n, 1]
    for h in range(pos.shape[1]):
        if not valid[n, h]:
            continue
        off_x, off_y = pos[n, h, 0] - pos[n, last, 0], pos[n, h, 1] - pos[n, last, 1]
        own[n, h, 0] = cos * off_x + sin * off_y
        own[n, h, 1] = cos * off_y - sin * off_x
        if h > 0 and valid[n, h - 1]:
            own[n, h, 2] = (own[n, h, 0] - own[n, h - 1, 0]) / period_s
            own[n, h, 3] = (own[n, h, 1] - own[n, h - 1, 1]) / period_s
        own[n, h, 4] = 1.0


@inner
def _place(owner, square, cell, m, distance):
    """Who is nearer to the track gets the cell."""
    if cell >= 0 and (owner[cell] < 0 or distance < square[cell]):
        owner[cell], square[cell] = m, distance


@kernel
def _write_grids(pos, valid, group, velocity, period_s, own, neighbour, pair, cells, direction):
    """Fills all that `GridFeatures` holds; `own`, `pair` and `cells` are zeros before."""
    count, last = valid.shape[0], valid.shape[1] - 1
    both = NUM_CELLS[0] + NUM_CELLS[1]
    owner, square = np.empty(both, np.int64), np.empty(both)
    for n in range(count):
        speed = math.sqrt(velocity[n, 0] ** 2 + velocity[n, 1] ** 2)
        direction[n, 0] = velocity[n, 0] / speed if speed > MIN_SPEED else 1.0
        direction[n, 1] = velocity[n, 1] / speed if speed > MIN_SPEED else 0.0
    first = 0
    for n in range(count):
        if group[n] != group[first]:
            first = n
        for slot in range(neighbour.shape[1]):
            neighbour[n, slot] = n
        if not valid[n, last]:
            continue
        _write_states(own, pos, valid, direction, n, period_s)
        cos, sin = direction[n, 0], direction[n, 1]
        for cell in range(both):
            owner[cell] = -1
        m = first
        while m < count and group[m] == group[n]:
            if m != n and valid[m, last]:
                off_x, off_y = pos[m, last, 0] - pos[n, last, 0], pos[m, last, 1] - pos[n, last, 1]
                ahead, left = cos * off_x + sin * off_y, cos * off_y - sin * off_x
                distance = off_x * off_x + off_y * off_y
                _place(owner, square, neighbour_cell(ahead, left), m, distance)
                cell = horizon_cell(ahead, left)
                _place(owner, square, cell + NUM_CELLS[0] if cell >= 0 else -1, m, distance)
            m += 1
        for slot in range(neighbour.shape[1]):  # the nearest first; who has been taken gives up both cells
            best = -1
            for cell in range(both):
                if owner[cell] >= 0 and (best < 0 or square[cell] < square[best]):
                    best = cell
            if best < 0:
                break
            m = owner[best]
            neighbour[n, slot] = m
            off_x, off_y = pos[m, last, 0] - pos[n, last, 0], pos[m, last, 1] - pos[n, last, 1]
            pair[n, slot, 0], pair[n, slot, 1] = cos * off_x + sin * off_y, cos * off_y - sin * off_x
            pair[n, slot, 2] = cos * direction[m, 0] + sin * direction[m, 1]
            pair[n, slot, 3] = cos * direction[m, 1] - sin * direction[m, 0]
            pair[n, slot, 4] = 1.0
            for cell in range(both):
                if owner[cell] == m:
                    cells[n, slot, cell] = 1.0
                    owner[cell] = -1


def compute_grids(histories: Histories, base: KalmanPredictor) -> GridFeatures:
    """Features of all tracks; the constant-velocity line is the tracker's, or `base`'s where there is none."""
    count, samples = histories.valid.shape
    velocity = base_velocity(histories, base)
    own = np.zeros((count, samples, STATE), np.float32)
    neighbour = np.zeros((count, SLOTS), np.int64)
    pair = np.zeros((count, SLOTS, PAIR), np.float32)
    cells = np.zeros((count, SLOTS, sum(NUM_CELLS)), np.float32)
    direction = np.empty((count, 2))
    period_s = float(histories.period_s)
    _write_grids(*as_kernels_read(histories), velocity, period_s, own, neighbour, pair, cells, direction)
    return GridFeatures(own, neighbour, pair, cells, velocity, direction)
