"""What a ray has met: which way the surface faces there, and what it is made of."""

from __future__ import annotations

import math
from typing import NamedTuple

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
from densecavoid.sim.people import HEAD, PARTS

CLOTHES, SKIN = -1, -2
"""Instead of the number of a material, on people."""


@inner
def cylinder_normal(cylinders, k, x, y, z):
    """Outward unit normal of cylinder k's surface at or near a point."""
    rel_x, rel_y = x - cylinders[k, CYL_X], y - cylinders[k, CYL_Y]
    distance = math.sqrt(rel_x * rel_x + rel_y * rel_y)
    side = abs(distance - cylinders[k, CYL_RADIUS])
    if min(abs(z - cylinders[k, CYL_Z_MAX]), abs(z - cylinders[k, CYL_Z_MIN])) < side:
        return 0.0, 0.0, 1.0 if 2.0 * z > cylinders[k, CYL_Z_MIN] + cylinders[k, CYL_Z_MAX] else -1.0
    scale = 1.0 / max(distance, 1e-9)
    return rel_x * scale, rel_y * scale, 0.0


@inner
def box_normal(boxes, k, x, y, z):
    """Outward unit normal of box k's surface at or near a point."""
    cos, sin = boxes[k, BOX_COS], boxes[k, BOX_SIN]
    rel_x, rel_y = x - boxes[k, BOX_X], y - boxes[k, BOX_Y]
    local_x, local_y = cos * rel_x + sin * rel_y, cos * rel_y - sin * rel_x
    off_x, off_y = abs(abs(local_x) - boxes[k, BOX_HALF_LENGTH]), abs(abs(local_y) - boxes[k, BOX_HALF_WIDTH])
    if min(abs(z - boxes[k, BOX_Z_MAX]), abs(z - boxes[k, BOX_Z_MIN])) < min(off_x, off_y):
        return 0.0, 0.0, 1.0 if 2.0 * z > boxes[k, BOX_Z_MIN] + boxes[k, BOX_Z_MAX] else -1.0
    if off_x < off_y:
        side = math.copysign(1.0, local_x)
        return side * cos, side * sin, 0.0
    side = math.copysign(1.0, local_y)
    return -side * sin, side * cos, 0.0


class Solids(NamedTuple):
    """What stands and walks in one world. Kernels that ask at every pixel take this and not the state of all worlds,
    which is so large that handing it on takes longer than the answer."""

    cylinders: np.ndarray  # f32 [.., 5] people's parts first
    boxes: np.ndarray  # f32 [.., 8]
    cylinder_material: np.ndarray  # u8 without people
    box_material: np.ndarray  # u8
    person_id: np.ndarray  # i32 [people]
    first_glass: int
    num_boxes: int


@kernel
def solids_of(state, b):
    """The solids of world b."""
    return Solids(
        state.cylinders[b],
        state.boxes[b],
        state.cylinder_material[b],
        state.box_material[b],
        state.person_id[b],
        state.num_boxes[b] - state.num_glass[b],
        state.num_boxes[b],
    )


@inner
def normal_at(solids, hit, x, y, z):
    """Unit normal of what a ray has met at a point, outward."""
    if hit < 0:
        return 0.0, 0.0, -1.0 if hit == CEILING else 1.0
    if hit < solids.cylinders.shape[0]:
        return cylinder_normal(solids.cylinders, hit, x, y, z)
    return box_normal(solids.boxes, hit - solids.cylinders.shape[0], x, y, z)


@inner
def material_at(solids, hit, ground, ceiling):
    """Number of the material of what a ray has met, or CLOTHES or SKIN of a person.

    Args:
        solids: of the world.
        hit: not NOTHING.
        ground: number of the ground's material; `ceiling` alike.
    """
    people_parts = PARTS * solids.person_id.shape[0]
    if hit < 0:
        return ceiling if hit == CEILING else ground
    if hit < people_parts:
        return SKIN if hit % PARTS == HEAD else CLOTHES
    if hit < solids.cylinders.shape[0]:
        return np.int64(solids.cylinder_material[hit - people_parts])
    return np.int64(solids.box_material[hit - solids.cylinders.shape[0]])
