"""Floor plans: walls, pillars and furniture as boxes and cylinders with heights. Only shapes; nothing moves here."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Float32

from densecavoid.frames import require

WALL_HEIGHT_M = 2.5
WALL_THICKNESS_M = 0.1


@dataclass
class FloorPlan:
    """What stands in a world. Grows by its methods; lengths in metres, angles in radians, world frame."""

    _boxes: list[tuple[float, ...]] = field(default_factory=list)
    _cylinders: list[tuple[float, ...]] = field(default_factory=list)

    @property
    def boxes(self) -> Float[np.ndarray, "n 7"]:
        """Rows (x, y, yaw, half length, half width, z_min, z_max)."""
        return np.array(self._boxes, dtype=np.float64).reshape(-1, 7)

    @property
    def cylinders(self) -> Float[np.ndarray, "m 5"]:
        """Rows (x, y, radius, z_min, z_max)."""
        return np.array(self._cylinders, dtype=np.float64).reshape(-1, 5)

    def packed(self) -> tuple[Float32[np.ndarray, "n 8"], Float32[np.ndarray, "m 5"]]:
        """Boxes and cylinders in the rows that kernels read (geometry.py): the yaw as cosine and sine."""
        boxes = self.boxes
        packed = np.column_stack([boxes[:, :2], np.cos(boxes[:, 2]), np.sin(boxes[:, 2]), boxes[:, 3:]])
        return packed.astype(np.float32), self.cylinders.astype(np.float32)

    def box(
        self, x: float, y: float, length: float, width: float, yaw: float = 0.0, z_min: float = 0.0, z_max: float = 1.0
    ) -> None:
        """An upright box, `length` along its own x axis.

        Raises:
            ValueError: if a size is not positive or a value not finite.
        """
        values = (x, y, yaw, length / 2, width / 2, z_min, z_max)
        require(
            all(map(math.isfinite, values)), "box (x, y, yaw, half length, half width, z_min, z_max)", values, "finite"
        )
        require(length > 0 and width > 0 and z_min < z_max, "box size", (length, width, z_min, z_max), "positive")
        self._boxes.append(values)

    def pillar(self, x: float, y: float, radius: float, z_min: float = 0.0, z_max: float = WALL_HEIGHT_M) -> None:
        """An upright cylinder.

        Raises:
            ValueError: if the radius or height is not positive or a value not finite.
        """
        values = (x, y, radius, z_min, z_max)
        require(all(map(math.isfinite, values)), "pillar (x, y, radius, z_min, z_max)", values, "finite")
        require(radius > 0 and z_min < z_max, "pillar size", (radius, z_min, z_max), "positive")
        self._cylinders.append(values)

    def wall(self, x0: float, y0: float, x1: float, y1: float, thickness: float = WALL_THICKNESS_M) -> None:
        """A wall whose centre line runs from (x0, y0) to (x1, y1)."""
        self.box(
            (x0 + x1) / 2,
            (y0 + y1) / 2,
            math.hypot(x1 - x0, y1 - y0) + thickness,
            thickness,
            math.atan2(y1 - y0, x1 - x0),
            0.0,
            WALL_HEIGHT_M,
        )

    def room(self, x_min: float, y_min: float, x_max: float, y_max: float) -> None:
        """Four walls whose inner faces are the given rectangle."""
        t = WALL_THICKNESS_M / 2
        corners = [(x_min - t, y_min - t), (x_max + t, y_min - t), (x_max + t, y_max + t), (x_min - t, y_max + t)]
        for (x0, y0), (x1, y1) in zip(corners, corners[1:] + corners[:1], strict=True):
            self.wall(x0, y0, x1, y1)

    def table(self, x: float, y: float, length: float, width: float, yaw: float = 0.0, height: float = 0.74) -> None:
        """Four thin legs and a top: a lidar at shin height sees the legs alone, a camera the top."""
        self.box(x, y, length, width, yaw, height - 0.04, height)
        self._legs(x, y, length - 0.08, width - 0.08, yaw, 0.05, height - 0.04)

    def chair(self, x: float, y: float, yaw: float = 0.0) -> None:
        """Four legs, a seat and a back; it faces `yaw`."""
        size = 0.44
        self.box(x, y, size, size, yaw, 0.42, 0.46)
        back = size / 2 - 0.02
        self.box(x - back * math.cos(yaw), y - back * math.sin(yaw), 0.04, size, yaw, 0.46, 0.90)
        self._legs(x, y, size - 0.04, size - 0.04, yaw, 0.04, 0.42)

    def _legs(
        self, x: float, y: float, length: float, width: float, yaw: float, thickness: float, height: float
    ) -> None:
        cos, sin = math.cos(yaw), math.sin(yaw)
        for along in (-length / 2, length / 2):
            for across in (-width / 2, width / 2):
                leg_x, leg_y = x + cos * along - sin * across, y + sin * along + cos * across
                self.box(leg_x, leg_y, thickness, thickness, yaw, 0.0, height)
