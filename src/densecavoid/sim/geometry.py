"""Plan-view geometry of the two footprints everything is made of: oriented rectangles and discs.

The same footprints serve the rays (rays.py), the collisions and the people who walk around them.
A box is a row (x, y, cos yaw, sin yaw, half length, half width, z_min, z_max), a cylinder (x, y, radius, z_min, z_max).
"""

from __future__ import annotations

import math

from densecavoid.sim._jit import inner

NOTHING, GROUND, CEILING = -1, -2, -3
"""What a ray meets when it meets no solid. Solids are numbered in a world: cylinders by row, then boxes, then the
triangles of meshes, with gaps where a world has less than its batch has room for."""

BOX_X, BOX_Y, BOX_COS, BOX_SIN, BOX_HALF_LENGTH, BOX_HALF_WIDTH, BOX_Z_MIN, BOX_Z_MAX = range(8)
CYL_X, CYL_Y, CYL_RADIUS, CYL_Z_MIN, CYL_Z_MAX = range(5)


@inner
def rectangle_offset(x, y, box):
    """Signed distance from a point to a rectangle's edge (negative inside), and the outward unit normal there."""
    cos, sin = box[BOX_COS], box[BOX_SIN]
    rel_x, rel_y = x - box[BOX_X], y - box[BOX_Y]
    local_x, local_y = cos * rel_x + sin * rel_y, cos * rel_y - sin * rel_x
    over_x, over_y = abs(local_x) - box[BOX_HALF_LENGTH], abs(local_y) - box[BOX_HALF_WIDTH]
    sign_x, sign_y = math.copysign(1.0, local_x), math.copysign(1.0, local_y)
    if over_x > 0.0 and over_y > 0.0:
        distance = math.sqrt(over_x * over_x + over_y * over_y)
        normal_x, normal_y = sign_x * over_x / distance, sign_y * over_y / distance
    elif over_x > over_y:
        distance, normal_x, normal_y = over_x, sign_x, 0.0
    else:
        distance, normal_x, normal_y = over_y, 0.0, sign_y
    return distance, cos * normal_x - sin * normal_y, sin * normal_x + cos * normal_y


@inner
def mark_disc(cells, x, y, inside, reach, x0, y0, cell):
    """Marks the cells [X, Y] of a grid whose centres are nearer to a point than `inside` with 1, and those nearer than
    `reach` that are 0 with 2.

    Args:
        x0, y0, cell: corner of the first cell, side of a cell.
    """
    first_i, last_i = max(int((x - reach - x0) / cell), 0), min(int((x + reach - x0) / cell) + 1, cells.shape[0])
    first_j, last_j = max(int((y - reach - y0) / cell), 0), min(int((y + reach - y0) / cell) + 1, cells.shape[1])
    for i in range(first_i, last_i):
        off_x = x0 + (i + 0.5) * cell - x
        for j in range(first_j, last_j):
            off_y = y0 + (j + 0.5) * cell - y
            distance_2 = off_x * off_x + off_y * off_y
            if distance_2 < inside * inside:
                cells[i, j] = 1
            elif distance_2 < reach * reach and cells[i, j] == 0:
                cells[i, j] = 2


@inner
def disc_offset(x, y, cylinder):
    """Signed distance from a point to a disc's edge (negative inside), and the outward unit normal there."""
    rel_x, rel_y = x - cylinder[CYL_X], y - cylinder[CYL_Y]
    centre_distance = math.sqrt(rel_x * rel_x + rel_y * rel_y)
    if centre_distance < 1e-9:
        return -cylinder[CYL_RADIUS], 1.0, 0.0
    return centre_distance - cylinder[CYL_RADIUS], rel_x / centre_distance, rel_y / centre_distance
