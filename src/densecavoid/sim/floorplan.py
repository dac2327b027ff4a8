"""Floor plans: walls, pillars and furniture as boxes and cylinders with heights. Only shapes; nothing moves here."""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32, UInt8

from densecavoid.frames import require
from densecavoid.sim.materials import GLASS, MATERIALS, material_number
from densecavoid.sim.mesh import Mesh, MeshPlace

WALL_HEIGHT_M = 2.5
WALL_THICKNESS_M = 0.1
DOOR_HEIGHT_M = 2.1


class PackedPlan(NamedTuple):
    """A floor plan in the rows that kernels read (geometry.py)."""

    boxes: Float32[np.ndarray, "n 8"]
    """The yaw as cosine and sine. Glass comes last."""
    cylinders: Float32[np.ndarray, "m 5"]
    box_material: UInt8[np.ndarray, "n"]
    """Numbers in `materials.MATERIALS`."""
    cylinder_material: UInt8[np.ndarray, "m"]
    num_glass: int
    """How many of the boxes, the last ones, are of glass."""


@dataclass
class FloorPlan:
    """What stands in a world. Grows by its methods; lengths in metres, angles in radians, world frame."""

    ceiling_m: float = WALL_HEIGHT_M
    """Height of the ceiling; inf outdoors."""
    _boxes: list[tuple[float, ...]] = field(default_factory=list)
    _cylinders: list[tuple[float, ...]] = field(default_factory=list)
    _box_material: list[int] = field(default_factory=list)
    _cylinder_material: list[int] = field(default_factory=list)
    _packed: tuple[tuple[int, int], PackedPlan] | None = field(default=None, compare=False, repr=False)
    """The last packing and how much it held: a plan only grows."""
    _meshes: list[MeshPlace] = field(default_factory=list)

    def __post_init__(self) -> None:
        require(self.ceiling_m > 0, "FloorPlan.ceiling_m", self.ceiling_m, "positive, inf outdoors")

    @property
    def boxes(self) -> Float[np.ndarray, "n 7"]:
        """Rows (x, y, yaw, half length, half width, z_min, z_max)."""
        return np.array(self._boxes, dtype=np.float64).reshape(-1, 7)

    @property
    def box_reach(self) -> Float[np.ndarray, "n 2"]:
        """How far each box reaches from its middle along x and y."""
        boxes = self.boxes
        cos, sin = np.abs(np.cos(boxes[:, 2])), np.abs(np.sin(boxes[:, 2]))
        return np.stack([cos * boxes[:, 3] + sin * boxes[:, 4], sin * boxes[:, 3] + cos * boxes[:, 4]], axis=1)

    @property
    def cylinders(self) -> Float[np.ndarray, "m 5"]:
        """Rows (x, y, radius, z_min, z_max)."""
        return np.array(self._cylinders, dtype=np.float64).reshape(-1, 5)

    @property
    def box_materials(self) -> list[str]:
        """Name of each box's material."""
        return [MATERIALS[number].name for number in self._box_material]

    @property
    def cylinder_materials(self) -> list[str]:
        """Name of each cylinder's material."""
        return [MATERIALS[number].name for number in self._cylinder_material]

    def copy(self) -> FloorPlan:
        """A plan of the same things that grows by itself."""
        twin = copy.copy(self)
        for name, value in vars(self).items():
            if isinstance(value, list):
                setattr(twin, name, list(value))
        return twin

    def cropped(self, x_min: float, y_min: float, x_max: float, y_max: float) -> FloorPlan:
        """A plan of the boxes and pillars that reach into a rectangle, or nearly."""
        low, high = np.array([x_min, y_min]), np.array([x_max, y_max])

        def inside(rows: Float[np.ndarray, "n k"], reach: Float[np.ndarray, "n"]) -> list[int]:
            near = (rows[:, :2] + reach[:, None] >= low) & (rows[:, :2] - reach[:, None] <= high)
            return np.flatnonzero(near.all(axis=1)).tolist()

        part = self.copy()
        boxes = inside(self.boxes, np.hypot(self.boxes[:, 3], self.boxes[:, 4]))
        pillars = inside(self.cylinders, self.cylinders[:, 2])
        part._boxes, part._box_material = [self._boxes[k] for k in boxes], [self._box_material[k] for k in boxes]
        part._cylinders = [self._cylinders[k] for k in pillars]
        part._cylinder_material = [self._cylinder_material[k] for k in pillars]
        part._packed = None
        return part

    @property
    def meshes(self) -> list[MeshPlace]:
        """Triangle meshes and where they stand."""
        return list(self._meshes)

    def packed(self) -> PackedPlan:
        """Everything, for the kernels. Not to be written to."""
        size = len(self._boxes), len(self._cylinders)
        if self._packed is None or self._packed[0] != size:
            self._packed = size, self._pack()
        return self._packed[1]

    def _pack(self) -> PackedPlan:
        material = np.array(self._box_material, np.uint8)
        order = np.argsort(material == GLASS, kind="stable")
        boxes, material = self.boxes[order], material[order]
        rows = np.column_stack([boxes[:, :2], np.cos(boxes[:, 2]), np.sin(boxes[:, 2]), boxes[:, 3:]])
        return PackedPlan(
            rows.astype(np.float32),
            self.cylinders.astype(np.float32),
            material,
            np.array(self._cylinder_material, np.uint8),
            int((material == GLASS).sum()),
        )

    def box(
        self,
        x: float,
        y: float,
        length: float,
        width: float,
        yaw: float = 0.0,
        z_min: float = 0.0,
        z_max: float = 1.0,
        material: str = "wood",
    ) -> None:
        """An upright box, `length` along its own x axis.

        Raises:
            ValueError: if a size is not positive, a value not finite, or there is no such material.
        """
        values = (x, y, yaw, length / 2, width / 2, z_min, z_max)
        require(
            all(map(math.isfinite, values)), "box (x, y, yaw, half length, half width, z_min, z_max)", values, "finite"
        )
        require(length > 0 and width > 0 and z_min < z_max, "box size", (length, width, z_min, z_max), "positive")
        self._box_material.append(material_number(material))
        self._boxes.append(values)

    def pillar(
        self,
        x: float,
        y: float,
        radius: float,
        z_min: float = 0.0,
        z_max: float = WALL_HEIGHT_M,
        material: str = "concrete",
    ) -> None:
        """An upright cylinder.

        Raises:
            ValueError: if the radius or height is not positive, a value not finite, there is no such material, or it is
                glass: only boxes can be.
        """
        values = (x, y, radius, z_min, z_max)
        require(all(map(math.isfinite, values)), "pillar (x, y, radius, z_min, z_max)", values, "finite")
        require(radius > 0 and z_min < z_max, "pillar size", (radius, z_min, z_max), "positive")
        number = material_number(material)
        require(not MATERIALS[number].see_through, "pillar material", material, "none that sensors look through")
        self._cylinder_material.append(number)
        self._cylinders.append(values)

    def mesh(self, mesh: Mesh, x: float, y: float, yaw: float = 0.0, z: float = 0.0) -> None:
        """A triangle mesh with its origin at (x, y, z), turned by `yaw`.

        Raises:
            ValueError: if a value is not finite.
        """
        values = (x, y, z, yaw)
        require(all(map(math.isfinite, values)), "mesh (x, y, z, yaw)", values, "finite")
        self._meshes.append(MeshPlace(mesh, *values))

    def wall(
        self,
        x0: float,
        y0: float,
        x1: float,
        y1: float,
        thickness: float = WALL_THICKNESS_M,
        material: str = "plaster",
        doors: Sequence[tuple[float, float]] = (),
    ) -> None:
        """A wall whose centre line runs from (x0, y0) to (x1, y1); of glass with that material.

        Args:
            x0: start.
            y0: start.
            x1: end.
            y1: end.
            thickness: of the wall, by which its ends reach beyond the line's (half each).
            material: of the wall.
            doors: (distance of the door's middle from the start, clear width) of each, with a lintel above it.

        Raises:
            ValueError: if a door reaches beyond the wall or into another door.
        """
        length, yaw = math.hypot(x1 - x0, y1 - y0), math.atan2(y1 - y0, x1 - x0)

        def part(begin: float, end: float, z_min: float = 0.0) -> None:
            at = (begin + end) / 2
            x, y = x0 + at * math.cos(yaw), y0 + at * math.sin(yaw)
            self.box(x, y, end - begin, thickness, yaw, z_min, WALL_HEIGHT_M, material)

        if not doors:
            x, y = (x0 + x1) / 2, (y0 + y1) / 2
            self.box(x, y, length + thickness, thickness, yaw, 0.0, WALL_HEIGHT_M, material)
            return
        begin = -thickness / 2
        for at, width in sorted(doors):
            require(width > 0, "door width", width, "positive")
            fits = begin <= at - width / 2 and at + width / 2 <= length + thickness / 2
            require(fits, "door (distance, width)", (at, width), f"inside a wall of {length:g} m, clear of other doors")
            if at - width / 2 > begin + 1e-6:
                part(begin, at - width / 2)
            part(at - width / 2, at + width / 2, DOOR_HEIGHT_M)
            begin = at + width / 2
        if begin < length + thickness / 2 - 1e-6:
            part(begin, length + thickness / 2)

    def room(self, x_min: float, y_min: float, x_max: float, y_max: float) -> None:
        """Four walls whose inner faces are the given rectangle."""
        t = WALL_THICKNESS_M / 2
        corners = [(x_min - t, y_min - t), (x_max + t, y_min - t), (x_max + t, y_max + t), (x_min - t, y_max + t)]
        for (x0, y0), (x1, y1) in zip(corners, corners[1:] + corners[:1], strict=True):
            self.wall(x0, y0, x1, y1)

    def table(self, x: float, y: float, length: float, width: float, yaw: float = 0.0, height: float = 0.74) -> None:
        """Four thin legs and a top: a lidar at shin height sees the legs alone, a camera the top."""
        self.box(x, y, length, width, yaw, height - 0.04, height)
        self._legs(x, y, length - 0.08, width - 0.08, yaw, 0.05, height - 0.04, "metal")

    def chair(self, x: float, y: float, yaw: float = 0.0) -> None:
        """Four legs, a seat and a back; it faces `yaw`."""
        size = 0.44
        self.box(x, y, size, size, yaw, 0.42, 0.46, "fabric")
        back = size / 2 - 0.02
        self.box(x - back * math.cos(yaw), y - back * math.sin(yaw), 0.04, size, yaw, 0.46, 0.90, "fabric")
        self._legs(x, y, size - 0.04, size - 0.04, yaw, 0.04, 0.42, "wood")

    def _legs(
        self,
        x: float,
        y: float,
        length: float,
        width: float,
        yaw: float,
        thickness: float,
        height: float,
        material: str,
    ) -> None:
        cos, sin = math.cos(yaw), math.sin(yaw)
        for along in (-length / 2, length / 2):
            for across in (-width / 2, width / 2):
                leg_x, leg_y = x + cos * along - sin * across, y + sin * along + cos * across
                self.box(leg_x, leg_y, thickness, thickness, yaw, 0.0, height, material)
