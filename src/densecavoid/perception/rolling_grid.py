"""Grids of cells that move with the robot, and what a camera puts into them: shared by maps and memories.

A cell's place is its number, counted from the odometry's origin, modulo the cells along a side, a power of two: a grid
moves without being copied.
"""

from __future__ import annotations

import math

import numpy as np

from densecavoid.perception.projection import ahead_per_depth, rise_per_depth
from densecavoid.sim._jit import inner

CELL_M = 0.1
LOWEST_M = 0.1
"""What is lower is floor."""


@inner
def move_grids(grids, centre, pose):
    """Brings the grids [G, C, C] of one world along: cells that come in are unknown (0).

    Args:
        centre: i64 [2] number of the cell that the robot is in; changed.
        pose: f64 [3] of the robot.
    """
    cells = grids.shape[1]
    half, mask = cells // 2, cells - 1
    for axis in range(2):
        now = math.floor(pose[axis] / CELL_M)
        moved = now - centre[axis]
        centre[axis] = now
        entering, count = (now + half - moved, moved) if moved > 0 else (now - half, -moved)
        for k in range(min(count, cells)):
            for g in range(grids.shape[0]):
                for across in range(cells):
                    if axis == 0:
                        grids[g, (entering + k) & mask, across] = 0
                    else:
                        grids[g, across, (entering + k) & mask] = 0


@inner
def find_nearest_things(nearest, depth, view, depth_limits, heights):
    """The nearest thing in each column of an image: `nearest` [width, 2] m ahead of the camera along the ground
    (infinite where there is nothing), and left.

    Args:
        depth: f32 [rows, width] along the optical axis (m).
        view: a `CameraView`.
        depth_limits: least and greatest depth (m).
        heights: of things, from and to (m).
    """
    for u in range(view.width):
        nearest[u, 0] = np.inf
    for v in range(depth.shape[0]):
        ahead, rise = ahead_per_depth(view, v + 0.5), rise_per_depth(view, v + 0.5)
        for u in range(depth.shape[1]):
            d = depth[v, u]
            if depth_limits[0] <= d <= depth_limits[1]:
                z = view.height_m + rise * d
                if heights[0] < z < heights[1] and ahead * d < nearest[u, 0]:
                    nearest[u, 0] = ahead * d
                    nearest[u, 1] = (0.5 * view.width - (u + 0.5)) / view.focal_x * d


@inner
def sees_past(nearest, view, forward, left, least):
    """Whether the camera sees farther than a place (m from it along the ground) in that place's column."""
    if not forward > least + CELL_M:
        return False
    u = math.floor(0.5 * view.width - view.focal_x * left / forward)
    return 0 <= u < view.width and nearest[u, 0] > forward + 1.5 * CELL_M
