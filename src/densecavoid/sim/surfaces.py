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
from densecavoid.sim.mesh import PLACE_COS, PLACE_NUMBER, PLACE_SIN
from densecavoid.sim.mesh_rays import triangle_of_hit
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
    first_triangle: int
    """Number of the first triangle of a mesh."""
    places: np.ndarray  # f64 [.., 6] of meshes


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
        state.cylinders.shape[1] + state.boxes.shape[1],
        state.meshes[b, : state.num_meshes[b]],
    )


@inner
def triangle_normal(solids, hit, meshes):
    """Unit normal of a placed mesh's triangle."""
    place, triangle = triangle_of_hit(hit - solids.first_triangle, solids.places, meshes)
    a, b, c = meshes.corners[triangle, 0], meshes.corners[triangle, 1], meshes.corners[triangle, 2]
    p_x, p_y, p_z = float(b[0] - a[0]), float(b[1] - a[1]), float(b[2] - a[2])
    q_x, q_y, q_z = float(c[0] - a[0]), float(c[1] - a[1]), float(c[2] - a[2])
    x, y, z = p_y * q_z - p_z * q_y, p_z * q_x - p_x * q_z, p_x * q_y - p_y * q_x
    scale = 1.0 / max(math.sqrt(x * x + y * y + z * z), 1e-12)
    cos, sin = solids.places[place, PLACE_COS] * scale, solids.places[place, PLACE_SIN] * scale
    return cos * x - sin * y, sin * x + cos * y, scale * z


@inner
def normal_at(solids, hit, x, y, z, meshes):
    """Unit normal of what a ray has met at a point, outward; `meshes` is None where no world has one."""
    if hit < 0:
        return 0.0, 0.0, -1.0 if hit == CEILING else 1.0
    if hit < solids.cylinders.shape[0]:
        return cylinder_normal(solids.cylinders, hit, x, y, z)
    if meshes is not None and hit >= solids.first_triangle:  # without meshes numba leaves this out
        return triangle_normal(solids, hit, meshes)
    return box_normal(solids.boxes, hit - solids.cylinders.shape[0], x, y, z)


@inner
def material_at(solids, hit, ground, ceiling, meshes):
    """Number of the material of what a ray has met, or CLOTHES or SKIN of a person.

    Args:
        solids: of the world.
        hit: not NOTHING.
        ground: number of the ground's material; `ceiling` alike.
        meshes: None where no world has one.
    """
    people_parts = PARTS * solids.person_id.shape[0]
    if hit < 0:
        return ceiling if hit == CEILING else ground
    if hit < people_parts:
        return SKIN if hit % PARTS == HEAD else CLOTHES
    if hit < solids.cylinders.shape[0]:
        return np.int64(solids.cylinder_material[hit - people_parts])
    if meshes is not None and hit >= solids.first_triangle:
        place, _ = triangle_of_hit(hit - solids.first_triangle, solids.places, meshes)
        return np.int64(meshes.material[int(solids.places[place, PLACE_NUMBER])])
    return np.int64(solids.box_material[hit - solids.cylinders.shape[0]])
