"""Triangle meshes: furniture or scanned rooms, checked, with a bounding hierarchy, packed for the kernels.

Loading and building only; what rays and bodies do with them is in mesh_rays.py and mesh_contact.py.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Float, Float32, Int, Int32

from densecavoid.frames import choose, require
from densecavoid.sim.materials import MATERIALS, material_number

MAX_TRIANGLES = 2_000_000
MAX_SIZE_M = 1000.0
_LEAF_TRIANGLES = 4


class Hierarchy(NamedTuple):
    """Boxes around ever fewer triangles, a box's first half right behind it: `skip` leads past all that is in a box."""

    low: Float32[np.ndarray, "nodes 3"]
    high: Float32[np.ndarray, "nodes 3"]
    skip: Int32[np.ndarray, "nodes"]
    first: Int32[np.ndarray, "nodes"]
    """First triangle of a leaf."""
    held: Int32[np.ndarray, "nodes"]
    """Triangles of a leaf; 0: not a leaf."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """A surface of triangles in its own frame (z up, metres). Shared by all worlds that show it: do not write.

    Made by `load_mesh`, `Mesh.from_triangles`, `Mesh.box` or `Mesh.wedge`.
    """

    name: str
    vertices: Float32[np.ndarray, "V 3"]
    faces: Int32[np.ndarray, "F 3"]
    """In the hierarchy's order."""
    material: str
    solid: bool
    """It has an inside: closed, and wound the same way all over."""
    hierarchy: Hierarchy

    @property
    def triangles(self) -> Float32[np.ndarray, "F 3 3"]:
        """Corners of each triangle."""
        return self.vertices[self.faces]

    @staticmethod
    def from_triangles(
        vertices: Float[np.ndarray, "V 3"],
        faces: Int[np.ndarray, "F 3"],
        allow_open: bool = False,
        material: str = "wood",
        name: str = "mesh",
    ) -> Mesh:
        """A mesh of given corners.

        Args:
            vertices: x, y, z in metres, z up.
            faces: three vertex numbers each, counter-clockwise seen from outside.
            allow_open: admits surfaces without an inside, such as scanned rooms: whoever is within them does not count
                as being inside of something.

        Raises:
            ValueError: if a vertex is not finite, a face names no vertex, no face has an area, it is larger than 1 km
                or has more than two million triangles, there is no such material or it is glass; and, without
                `allow_open`, if it has holes or neighbouring faces are wound differently.
        """
        what = f"mesh {name!r}"
        require(not MATERIALS[material_number(material)].see_through, f"{what} material", material, "not see-through")
        require(len(faces) > 0, f"{what} triangles", len(faces), "at least one")
        require(len(faces) <= MAX_TRIANGLES, f"{what} triangles", len(faces), f"at most {MAX_TRIANGLES}: simplify it")
        finite = np.isfinite(vertices).all(axis=1)
        require(bool(finite.all()), f"{what} vertex", vertices[~finite][:1].tolist(), "finite")
        named = faces.min(), faces.max()
        require(
            named[0] >= 0 and named[1] < len(vertices), f"{what} vertex numbers", named, f"0 to {len(vertices) - 1}"
        )
        size = float(np.ptp(vertices[np.unique(faces)], axis=0).max())
        require(size <= MAX_SIZE_M, f"{what} size", f"{size:.4g} m", f"at most {MAX_SIZE_M:.0f} m: is it in metres?")
        # Files without an index (STL) repeat corners; one place is one vertex here.
        places, number = np.unique(vertices.astype(np.float32) + np.float32(0.0), axis=0, return_inverse=True)
        joined = number.reshape(-1)[faces].astype(np.int32)
        joined = joined[(joined != np.roll(joined, 1, axis=1)).all(axis=1)]
        corners = places[joined].astype(np.float64)
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
        require(bool((area > 0).any()), f"{what} area", 0.0, "more than nothing: all its triangles are degenerate")
        open_edges, turned_edges = _edges_amiss(joined, len(places))
        require(
            allow_open or open_edges == 0,
            f"{what} open edges",
            open_edges,
            "0, a closed surface; allow_open=True admits scanned rooms and other surfaces with holes",
        )
        require(
            allow_open or turned_edges == 0,
            f"{what} edges between faces wound differently",
            turned_edges,
            "0; allow_open=True admits it as a surface without an inside",
        )
        order, hierarchy = _build_hierarchy(places[joined[area > 0]])
        faces_in_order = joined[area > 0][order]
        for array in (places, faces_in_order, *hierarchy):
            array.setflags(write=False)
        return Mesh(name, places, faces_in_order, material, not open_edges and not turned_edges, hierarchy)

    @staticmethod
    def box(length: float, width: float, height: float, material: str = "wood") -> Mesh:
        """A box on the ground around the origin: twelve triangles."""
        return _prism(
            [(-length / 2, 0.0), (length / 2, 0.0), (length / 2, height), (-length / 2, height)], width, material
        )

    @staticmethod
    def wedge(length: float, width: float, height: float, material: str = "concrete") -> Mesh:
        """A ramp around the origin that rises along x from the ground at -length/2 to `height` at length/2."""
        return _prism([(-length / 2, 0.0), (length / 2, 0.0), (length / 2, height)], width, material)


def load_mesh(
    path: str | Path,
    scale: float = 1.0,
    up: Literal["z", "y"] = "z",
    allow_open: bool = False,
    material: str = "wood",
) -> Mesh:
    """Reads OBJ, STL, PLY, GLB or whatever else trimesh knows; all parts of a scene become one mesh.

    Args:
        scale: metres a unit of the file (.001 for millimetres).
        up: the file's upward axis; glTF and many OBJ files have y.
        allow_open: see `Mesh.from_triangles`.

    Raises:
        ValueError: if there is no such file, it cannot be read, or is refused by `Mesh.from_triangles`.
        ModuleNotFoundError: without trimesh (the extra `mesh`).
    """
    choose("load_mesh up", up, ("z", "y"))
    require(math.isfinite(scale) and scale > 0, "load_mesh scale", scale, "positive metres a unit")
    path = Path(path)
    require(path.is_file(), "mesh file", str(path), "a file that exists")
    try:
        trimesh: Any = importlib.import_module("trimesh")
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError("reading mesh files needs trimesh: pip install 'densecavoid[mesh]'") from error
    try:
        read = trimesh.load(path, force="mesh")
        vertices, faces = np.array(read.vertices, np.float64), np.array(read.faces, np.int64)
    except Exception as error:  # each of trimesh's readers fails in a way of its own
        raise ValueError(f"mesh file {str(path)!r}: cannot be read ({type(error).__name__}: {error})") from error
    require(faces.ndim == 2 and len(faces) > 0, f"mesh {path.name!r} triangles", 0, "at least one")
    if read.is_watertight and not read.is_winding_consistent:
        trimesh.repair.fix_normals(read)
        faces = np.array(read.faces, np.int64)
    if up == "y":
        vertices = np.stack([vertices[:, 0], -vertices[:, 2], vertices[:, 1]], axis=1)
    return Mesh.from_triangles(vertices * scale, faces, allow_open, material, path.name)


class MeshPlace(NamedTuple):
    """A mesh and where it stands: its frame's origin and turn in the world."""

    mesh: Mesh
    x: float
    y: float
    z: float
    yaw: float


class MeshSet(NamedTuple):
    """All meshes that some worlds show, one after another, as the kernels read them."""

    first_node: np.ndarray  # i64 [K + 1]
    first_triangle: np.ndarray  # i64 [K + 1]
    solid: np.ndarray  # bool [K]
    material: np.ndarray  # u8 [K] numbers in materials.MATERIALS
    node_low: np.ndarray  # f32 [N, 3]
    node_high: np.ndarray  # f32 [N, 3]
    node_skip: np.ndarray  # i32 [N] all three count from the mesh's own first node and first triangle
    node_first: np.ndarray  # i32 [N]
    node_count: np.ndarray  # i32 [N]
    corners: np.ndarray  # f32 [T, 3, 3]


PLACE_NUMBER, PLACE_X, PLACE_Y, PLACE_Z, PLACE_COS, PLACE_SIN = range(6)
"""Columns of a placed mesh: its number in the set, its origin, cosine and sine of its turn."""


@lru_cache(maxsize=4)
def mesh_set(meshes: tuple[Mesh, ...]) -> MeshSet:
    """The set of these meshes, numbered in this order; kept for the next call."""
    return MeshSet(
        first_node=np.cumsum([0, *(len(mesh.hierarchy.skip) for mesh in meshes)]),
        first_triangle=np.cumsum([0, *(len(mesh.faces) for mesh in meshes)]),
        solid=np.array([mesh.solid for mesh in meshes]),
        material=np.array([material_number(mesh.material) for mesh in meshes], np.uint8),
        node_low=np.concatenate([mesh.hierarchy.low for mesh in meshes]),
        node_high=np.concatenate([mesh.hierarchy.high for mesh in meshes]),
        node_skip=np.concatenate([mesh.hierarchy.skip for mesh in meshes]),
        node_first=np.concatenate([mesh.hierarchy.first for mesh in meshes]),
        node_count=np.concatenate([mesh.hierarchy.held for mesh in meshes]),
        corners=np.concatenate([mesh.triangles for mesh in meshes]),
    )


def place_rows(places: Sequence[MeshPlace], numbers: Sequence[int]) -> Float[np.ndarray, "M 6"]:
    """Placed meshes as the kernels read them; `numbers` are their meshes' in the set."""
    rows = [(k, p.x, p.y, p.z, math.cos(p.yaw), math.sin(p.yaw)) for p, k in zip(places, numbers, strict=True)]
    return np.array(rows, np.float64).reshape(-1, 6)


def _prism(profile: list[tuple[float, float]], width: float, material: str) -> Mesh:
    """A convex profile (x, z), counter-clockwise seen from -y, drawn along y."""
    require(
        all(math.isfinite(value) for point in (*profile, (width, 0.0)) for value in point)
        and width > 0
        and np.ptp(np.array(profile), axis=0).min() > 0,
        "mesh size",
        (profile, width),
        "positive and finite",
    )
    n = len(profile)
    vertices = np.array([(x, side * width / 2, z) for side in (-1, 1) for x, z in profile])
    faces = [face for i in range(1, n - 1) for face in ((0, i, i + 1), (n, n + i + 1, n + i))]
    for i in range(n):
        j = (i + 1) % n
        faces += [(i, n + i, n + j), (i, n + j, j)]
    return Mesh.from_triangles(vertices, np.array(faces), material=material, name="box" if n == 4 else "wedge")


def _edges_amiss(faces: Int32[np.ndarray, "F 3"], num_vertices: int) -> tuple[int, int]:
    """How many edges have an odd number of faces (a hole's rim), and how many others have faces wound differently."""
    start, end = faces.ravel().astype(np.int64), np.roll(faces, -1, axis=1).ravel().astype(np.int64)
    edge, where = np.unique(np.minimum(start, end) * num_vertices + np.maximum(start, end), return_inverse=True)
    uses = np.bincount(where, minlength=len(edge))
    balance = np.bincount(where, weights=np.where(start < end, 1.0, -1.0), minlength=len(edge))
    is_open = uses % 2 == 1
    return int(is_open.sum()), int(((balance != 0) & ~is_open).sum())


def _build_hierarchy(corners: Float32[np.ndarray, "F 3 3"]) -> tuple[Int[np.ndarray, "F"], Hierarchy]:
    """Halves the triangles along the longest side of their centres' box until few are left; a level at a time.

    Returns:
        The triangles' new order, and the boxes.
    """
    count = len(corners)
    low, high, centre = corners.min(axis=1), corners.max(axis=1), corners.mean(axis=1)
    sizes: dict[int, int] = {}

    def num_nodes(n: int) -> int:
        if n not in sizes:
            sizes[n] = 1 if n <= _LEAF_TRIANGLES else 1 + num_nodes(n // 2) + num_nodes(n - n // 2)
        return sizes[n]

    total = num_nodes(count)
    nodes = Hierarchy(
        np.empty((total, 3), np.float32),
        np.empty((total, 3), np.float32),
        np.empty(total, np.int32),
        np.zeros(total, np.int32),
        np.zeros(total, np.int32),
    )
    order = np.arange(count)
    start, stop, index = np.array([0]), np.array([count]), np.array([0])
    while len(start):
        # Positions of all triangles that are still in a box of this level, box by box.
        length = stop - start
        box = np.repeat(np.arange(len(start)), length)
        first = np.cumsum(length) - length
        position = np.arange(length.sum()) - np.repeat(first - start, length)
        here = order[position]
        nodes.low[index] = np.minimum.reduceat(low[here], first)
        nodes.high[index] = np.maximum.reduceat(high[here], first)
        nodes.skip[index] = index + np.array([num_nodes(int(n)) for n in length])
        leaf = length <= _LEAF_TRIANGLES
        nodes.first[index[leaf]], nodes.held[index[leaf]] = start[leaf], length[leaf]
        extent = np.maximum.reduceat(centre[here], first) - np.minimum.reduceat(centre[here], first)
        along = centre[here, extent.argmax(axis=1)[box]]
        order[position] = here[np.lexsort((along, box))]
        start, stop, index = start[~leaf], stop[~leaf], index[~leaf]
        middle = start + (stop - start) // 2
        second = index + 1 + np.array([num_nodes(int(n)) for n in middle - start], np.int64)
        start, stop = np.stack([start, middle], axis=1).ravel(), np.stack([middle, stop], axis=1).ravel()
        index = np.stack([index + 1, second], axis=1).ravel()
    return order, nodes
