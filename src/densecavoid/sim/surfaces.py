"""What a ray has met: which way the surface faces there, and what it is made of."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from densecavoid.sim._jit import inner, views
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
from densecavoid.sim.mesh import PLACE_COS, PLACE_NUMBER, PLACE_SIN, MeshSet
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
    places: np.ndarray  # f64 [M, 6] of meshes
    meshes: MeshSet | None


@views
def solids_of(state, b, meshes):
    """The solids of world b, and the set its meshes are from, or None."""
    return Solids(
        state.cylinders[b],
        state.boxes[b],
        state.cylinder_material[b],
        state.box_material[b],
        state.person_id[b],
        state.num_boxes[b] - state.num_glass[b],
        state.num_boxes[b],
        state.meshes[b],
        meshes,
    )


@inner
def _mesh_normal(meshes, places, number):
    """Unit normal of a mesh's triangle. Without meshes there is none, and numba leaves out the rest."""
    if meshes is None:
        return 0.0, 0.0, 1.0
    m, triangle = triangle_of_hit(number, places, meshes)
    a, b, c = meshes.corners[triangle, 0], meshes.corners[triangle, 1], meshes.corners[triangle, 2]
    px, py, pz = float(b[0] - a[0]), float(b[1] - a[1]), float(b[2] - a[2])
    qx, qy, qz = float(c[0] - a[0]), float(c[1] - a[1]), float(c[2] - a[2])
    x, y, z = py * qz - pz * qy, pz * qx - px * qz, px * qy - py * qx
    scale = 1.0 / max(math.sqrt(x * x + y * y + z * z), 1e-30)
    cos, sin = places[m, PLACE_COS] * scale, places[m, PLACE_SIN] * scale
    return cos * x - sin * y, sin * x + cos * y, z * scale


@inner
def _mesh_material(meshes, places, number):
    """Number of the material of a mesh."""
    if meshes is None:
        return 0
    m, _ = triangle_of_hit(number, places, meshes)
    return np.int64(meshes.material[int(places[m, PLACE_NUMBER])])


@inner
def normal_at(solids, hit, x, y, z):
    """Unit normal of what a ray has met at a point, outward."""
    if hit < 0:
        return 0.0, 0.0, -1.0 if hit == CEILING else 1.0
    if hit < solids.cylinders.shape[0]:
        return cylinder_normal(solids.cylinders, hit, x, y, z)
    hit -= solids.cylinders.shape[0]
    if hit < solids.boxes.shape[0]:
        return box_normal(solids.boxes, hit, x, y, z)
    return _mesh_normal(solids.meshes, solids.places, hit - solids.boxes.shape[0])


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
    hit -= solids.cylinders.shape[0]
    if hit < solids.boxes.shape[0]:
        return np.int64(solids.box_material[hit])
    return _mesh_material(solids.meshes, solids.places, hit - solids.boxes.shape[0])
