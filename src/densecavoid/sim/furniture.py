"""Furniture with the height profile that sensors meet: what a lidar at shin height misses, a camera sees.

Each function adds one piece to a floor plan, centred at (x, y) and facing `yaw`: its depth runs along `yaw`, its width
across. Dimensions are round figures of common furniture: work tops at .74 m, seats at .42 to .45 m, counters at 1.1 m,
shelves of 1.8 m, kerbs of .10 to .15 m.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from densecavoid.frames import choose, require
from densecavoid.sim.floorplan import FloorPlan


def _at(x: float, y: float, yaw: float, ahead: float, left: float) -> tuple[float, float]:
    cos, sin = math.cos(yaw), math.sin(yaw)
    return x + cos * ahead - sin * left, y + sin * ahead + cos * left


def table(plan: FloorPlan, x: float, y: float, yaw: float = 0.0, width: float = 1.4, depth: float = 0.7) -> None:
    """Four legs and a top."""
    plan.table(x, y, depth, width, yaw)


def chair(plan: FloorPlan, x: float, y: float, yaw: float = 0.0) -> None:
    """Four legs, a seat and a back."""
    plan.chair(x, y, yaw)


def desk(plan: FloorPlan, x: float, y: float, yaw: float = 0.0, width: float = 1.6, depth: float = 0.8) -> None:
    """A top on two side panels, with a screen on it; one sits at its front."""
    plan.box(x, y, depth, width, yaw, 0.70, 0.74)
    for left in (-width / 2 + 0.02, width / 2 - 0.02):
        plan.box(*_at(x, y, yaw, 0.0, left), depth - 0.1, 0.04, yaw, 0.0, 0.70, "metal")
    plan.box(*_at(x, y, yaw, -depth / 4, 0.0), 0.05, 0.6, yaw, 0.84, 1.2, "black")


def shelf(plan: FloorPlan, x: float, y: float, yaw: float = 0.0, width: float = 1.0, depth: float = 0.35) -> None:
    """A full shelf or cupboard, closed to the floor."""
    plan.box(x, y, depth, width, yaw, 0.0, 1.8)


def sofa(plan: FloorPlan, x: float, y: float, yaw: float = 0.0, width: float = 2.0, depth: float = 0.9) -> None:
    """Seat, back and arms, a hand above the floor."""
    plan.box(x, y, depth, width, yaw, 0.10, 0.42, "fabric")
    plan.box(*_at(x, y, yaw, -depth / 2 + 0.11, 0.0), 0.22, width, yaw, 0.42, 0.82, "fabric")
    for left in (-width / 2 + 0.1, width / 2 - 0.1):
        plan.box(*_at(x, y, yaw, 0.11, left), depth - 0.22, 0.2, yaw, 0.42, 0.60, "fabric")


def armchair(plan: FloorPlan, x: float, y: float, yaw: float = 0.0) -> None:
    """A sofa for one."""
    sofa(plan, x, y, yaw, width=0.9, depth=0.85)


def counter(plan: FloorPlan, x: float, y: float, yaw: float = 0.0, width: float = 2.4, depth: float = 0.7) -> None:
    """A reception: a closed front under a top that stands out at its front."""
    plan.box(*_at(x, y, yaw, -0.1, 0.0), depth - 0.2, width, yaw, 0.0, 1.06, "wood")
    plan.box(x, y, depth, width, yaw, 1.06, 1.1, "plastic")


def bench(plan: FloorPlan, x: float, y: float, yaw: float = 0.0, width: float = 1.6, depth: float = 0.45) -> None:
    """A seat on two concrete feet."""
    plan.box(x, y, depth, width, yaw, 0.40, 0.45)
    for left in (-width / 2 + 0.2, width / 2 - 0.2):
        plan.box(*_at(x, y, yaw, 0.0, left), depth - 0.05, 0.15, yaw, 0.0, 0.40, "concrete")


def bin_(plan: FloorPlan, x: float, y: float, yaw: float = 0.0) -> None:
    """A litter bin."""
    plan.pillar(x, y, 0.22, 0.0, 0.8, "metal")


def plant(plan: FloorPlan, x: float, y: float, yaw: float = 0.0) -> None:
    """A pot and the leaves above it, wider than the pot."""
    plan.pillar(x, y, 0.20, 0.0, 0.40, "plastic")
    plan.pillar(x, y, 0.32, 0.50, 1.5, "plant")


def planter(plan: FloorPlan, x: float, y: float, yaw: float = 0.0, width: float = 1.6, depth: float = 0.6) -> None:
    """A concrete trough with shrubs."""
    plan.box(x, y, depth, width, yaw, 0.0, 0.5, "concrete")
    plan.box(x, y, depth - 0.1, width - 0.1, yaw, 0.5, 1.0, "plant")


def tree(plan: FloorPlan, x: float, y: float, yaw: float = 0.0) -> None:
    """A trunk, and a crown to walk under."""
    plan.pillar(x, y, 0.15, 0.0, 2.4, "wood")
    plan.pillar(x, y, 1.4, 2.4, 5.0, "plant")


def lamp_post(plan: FloorPlan, x: float, y: float, yaw: float = 0.0) -> None:
    """A street lamp's pole."""
    plan.pillar(x, y, 0.07, 0.0, 4.0, "metal")


def trolley(plan: FloorPlan, x: float, y: float, yaw: float = 0.0, width: float = 0.6, depth: float = 1.0) -> None:
    """A platform trolley: a deck lower than the lidar looks, and a handle at its back."""
    plan.box(x, y, depth, width, yaw, 0.20, 0.24, "metal")
    back = -depth / 2 + 0.02
    for left in (-width / 2 + 0.02, width / 2 - 0.02):
        plan.box(*_at(x, y, yaw, back, left), 0.04, 0.04, yaw, 0.24, 0.95, "metal")
        for ahead in (back + 0.08, -back - 0.08):
            plan.box(*_at(x, y, yaw, ahead, left), 0.1, 0.04, yaw, 0.0, 0.20, "black")
    plan.box(*_at(x, y, yaw, back, 0.0), 0.04, width, yaw, 0.91, 0.95, "metal")


def vending_machine(plan: FloorPlan, x: float, y: float, yaw: float = 0.0) -> None:
    """A tall machine with a dark front."""
    plan.box(x, y, 0.80, 0.90, yaw, 0.0, 1.83, "metal")
    plan.box(*_at(x, y, yaw, 0.41, 0.0), 0.02, 0.80, yaw, 0.5, 1.7, "black")


def kerb(
    plan: FloorPlan, x0: float, y0: float, x1: float, y1: float, height: float = 0.12, width: float = 0.15
) -> None:
    """A kerb stone's line from (x0, y0) to (x1, y1): a robot runs against it, people step over, the lidar misses it.

    Raises:
        ValueError: if it is higher than a step, .2 m.
    """
    require(0 < height <= 0.2, "kerb height", height, "at most 0.2 m")
    length, yaw = math.hypot(x1 - x0, y1 - y0), math.atan2(y1 - y0, x1 - x0)
    plan.box((x0 + x1) / 2, (y0 + y1) / 2, length + width, width, yaw, 0.0, height, "concrete")


def ramp(
    plan: FloorPlan, x: float, y: float, length: float, width: float, yaw: float, height: float, steps: int = 8
) -> None:
    """A slope that rises along `yaw` to `height`, as low steps; centred at (x, y).

    Raises:
        ValueError: if a size is not positive.
    """
    require(length > 0 and width > 0 and height > 0 and steps >= 1, "ramp", (length, width, height, steps), "positive")
    tread = length / steps
    for k in range(steps):
        top = height * (k + 0.5) / steps
        plan.box(*_at(x, y, yaw, (k + 0.5) * tread - length / 2, 0.0), tread, width, yaw, 0.0, top, "concrete")


Build = Callable[[FloorPlan, float, float, float], None]
"""Adds one piece of furniture, of its usual size, to a plan at (x, y, yaw)."""


@dataclass(frozen=True)
class Piece:
    """A kind of furniture and the floor it takes."""

    build: Build
    depth_m: float
    width_m: float

    @property
    def reach_m(self) -> float:
        """From its centre to its farthest corner."""
        return math.hypot(self.depth_m, self.width_m) / 2


PIECES: dict[str, Piece] = {
    "table": Piece(table, 0.7, 1.4),
    "chair": Piece(chair, 0.44, 0.44),
    "desk": Piece(desk, 0.8, 1.6),
    "shelf": Piece(shelf, 0.35, 1.0),
    "sofa": Piece(sofa, 0.9, 2.0),
    "armchair": Piece(armchair, 0.85, 0.9),
    "counter": Piece(counter, 0.7, 2.4),
    "bench": Piece(bench, 0.45, 1.6),
    "bin": Piece(bin_, 0.44, 0.44),
    "plant": Piece(plant, 0.64, 0.64),
    "planter": Piece(planter, 0.6, 1.6),
    "tree": Piece(tree, 0.30, 0.30),
    "lamp-post": Piece(lamp_post, 0.14, 0.14),
    "trolley": Piece(trolley, 1.0, 0.6),
    "vending-machine": Piece(vending_machine, 0.84, 0.9),
}
"""Furniture by name."""


def place(plan: FloorPlan, kind: str, x: float, y: float, yaw: float = 0.0) -> None:
    """Adds a piece by its name, of its usual size.

    Raises:
        ValueError: naming the kinds there are.
    """
    PIECES[choose("furniture", kind, tuple(PIECES))].build(plan, x, y, yaw)
