"""What a ray has met: which way the surface faces there, and what it is made of."""

from __future__ import annotations

import math

import numpy as np

from densecavoid.sim._jit import inner, kernel
from densecavoid.sim.geometry import (
    BOX_COS,
    BOX_HALF_LENGTH,
    BOX_HALF_WIDTH,
    BOX_SIN,
    BOX_X,
    BOX_Y,
    BOX_Z_MAX,
    BOX_Z_MIN,
    CEILING,
    CYL_RADIUS,
    CYL_X,
    CYL_Y,
    CYL_Z_MAX,
    CYL_Z_MIN,
)
from densecavoid.sim.people import PARTS

CLOTHES, SKIN = -1, -2
"""Instead of the number of a material, on people."""


@kernel
def cylinder_normal(cylinder, x, y, z):
    """Outward unit normal of a cylinder's surface at or near a point."""
    rel_x, rel_y = x - cylinder[CYL_X], y - cylinder[CYL_Y]
    distance = math.sqrt(rel_x * rel_x + rel_y * rel_y)
    side = abs(distance - cylinder[CYL_RADIUS])
    if min(abs(z - cylinder[CYL_Z_MAX]), abs(z - cylinder[CYL_Z_MIN])) < side:
        return 0.0, 0.0, 1.0 if 2.0 * z > cylinder[CYL_Z_MIN] + cylinder[CYL_Z_MAX] else -1.0
    scale = 1.0 / max(distance, 1e-9)
    return rel_x * scale, rel_y * scale, 0.0


@kernel
def box_normal(box, x, y, z):
    """Outward unit normal of a box's surface at or near a point."""
    cos, sin = box[BOX_COS], box[BOX_SIN]
    rel_x, rel_y = x - box[BOX_X], y - box[BOX_Y]
    local_x, local_y = cos * rel_x + sin * rel_y, cos * rel_y - sin * rel_x
    off_x, off_y = abs(abs(local_x) - box[BOX_HALF_LENGTH]), abs(abs(local_y) - box[BOX_HALF_WIDTH])
    if min(abs(z - box[BOX_Z_MAX]), abs(z - box[BOX_Z_MIN])) < min(off_x, off_y):
        return 0.0, 0.0, 1.0 if 2.0 * z > box[BOX_Z_MIN] + box[BOX_Z_MAX] else -1.0
    if off_x < off_y:
        side = math.copysign(1.0, local_x)
        return side * cos, side * sin, 0.0
    side = math.copysign(1.0, local_y)
    return -side * sin, side * cos, 0.0


@inner
def normal_at(state, b, hit, x, y, z):
    """Unit normal of what a ray has met at a point of world b, outward."""
    if hit < 0:
        return 0.0, 0.0, -1.0 if hit == CEILING else 1.0
    if hit < state.cylinders.shape[1]:
        return cylinder_normal(state.cylinders[b, hit], x, y, z)
    return box_normal(state.boxes[b, hit - state.cylinders.shape[1]], x, y, z)


@inner
def material_at(state, b, hit, ground, ceiling):
    """Number of the material of what a ray has met, or CLOTHES or SKIN of a person.

    Args:
        hit: not NOTHING.
        ground: number of the ground's material; `ceiling` alike.
    """
    people_parts = PARTS * state.pos.shape[1]
    if hit < 0:
        return ceiling if hit == CEILING else ground
    if hit < people_parts:
        return SKIN if hit % PARTS == PARTS - 1 else CLOTHES
    if hit < state.cylinders.shape[1]:
        return np.int64(state.cylinder_material[b, hit - people_parts])
    return np.int64(state.box_material[b, hit - state.cylinders.shape[1]])
