"""Furnishing rooms: clutter with tight but passable gaps, pieces along the walls, pieces standing free."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from densecavoid.scenarios.free_space import Area, clearances_m
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.furniture import PIECES, Piece

KeepFree = Sequence[tuple[float, float, float]]
"""Circles (x, y, radius) that no furniture reaches into."""

_TIGHT_GAP_M = (0.9, 1.1)
_TRIES_EACH = 40


def clutter(rng: np.random.Generator, plan: FloorPlan, area: Area, count: int) -> None:
    """Adds `count` obstacles to the plan, or as many as there is room for.

    Half of them stand a tight gap away from one that is already there; none overlap.
    """
    placed: list[tuple[float, float, float]] = []  # x, y, radius of the outline
    for _ in range(count):
        kind = rng.choice(["box", "pillar", "table", "chair"], p=[0.4, 0.2, 0.2, 0.2])
        length, width = _size(rng, str(kind))
        outline = math.hypot(length, width) / 2 if kind != "pillar" else length / 2
        for _ in range(_TRIES_EACH):
            if placed and rng.random() < 0.5:
                x0, y0, r0 = placed[rng.integers(len(placed))]
                distance, angle = r0 + outline + rng.uniform(*_TIGHT_GAP_M), rng.uniform(0, 2 * math.pi)
                x, y = x0 + distance * math.cos(angle), y0 + distance * math.sin(angle)
            else:
                x, y = rng.uniform(area[0], area[2]), rng.uniform(area[1], area[3])
            inside = area[0] < x - outline and x + outline < area[2] and area[1] < y - outline and y + outline < area[3]
            if inside and all(math.hypot(x - a, y - b) > r + outline for a, b, r in placed):
                placed.append((x, y, outline))
                _build(rng, plan, str(kind), x, y, length, width)
                break


def _size(rng: np.random.Generator, kind: str) -> tuple[float, float]:
    if kind == "box":
        return rng.uniform(0.3, 0.8), rng.uniform(0.3, 0.8)
    if kind == "pillar":
        diameter = rng.uniform(0.2, 0.6)
        return diameter, diameter
    if kind == "table":
        return rng.uniform(0.9, 1.4), rng.uniform(0.6, 0.8)
    return 0.44, 0.44


def _build(
    rng: np.random.Generator, plan: FloorPlan, kind: str, x: float, y: float, length: float, width: float
) -> None:
    yaw = rng.uniform(-math.pi, math.pi)
    if kind == "box":
        plan.box(x, y, length, width, yaw, 0.0, rng.uniform(0.5, 1.8))
    elif kind == "pillar":
        plan.pillar(x, y, length / 2)
    elif kind == "table":
        plan.table(x, y, length, width, yaw)
    else:
        plan.chair(x, y, yaw)


def against_walls(
    rng: np.random.Generator, plan: FloorPlan, room: Area, kinds: Sequence[str], count: int, keep_free: KeepFree = ()
) -> None:
    """Adds up to `count` pieces with their backs to the walls of a rectangular room, facing into it.

    Args:
        rng: chooses pieces and places.
        plan: grows by them.
        room: inner faces of its walls.
        kinds: of `PIECES`, to choose from.
        count: how many to try.
        keep_free: (x, y, radius) of places to stay away from: doors, the robot's ends.
    """
    for _ in range(count):
        piece = PIECES[str(rng.choice(kinds))]
        for _ in range(_TRIES_EACH // 2):
            side, back = int(rng.integers(4)), piece.depth_m / 2 + 0.04
            low, high = room[1 - side % 2], room[3 - side % 2]
            along = rng.uniform(low + piece.width_m / 2 + 0.1, max(low + piece.width_m, high - piece.width_m / 2 - 0.1))
            x, y = [(room[0] + back, along), (along, room[1] + back), (room[2] - back, along), (along, room[3] - back)][
                side
            ]
            yaw = side * math.pi / 2
            if _stands_free(plan, piece, x, y, yaw, 0.02, keep_free):
                piece.build(plan, x, y, yaw)
                break


def scatter(
    rng: np.random.Generator,
    plan: FloorPlan,
    area: Area,
    kinds: Sequence[str],
    count: int,
    gap_m: float,
    keep_free: KeepFree = (),
) -> None:
    """Adds up to `count` pieces anywhere in an area, `gap_m` from everything else."""
    for _ in range(count):
        piece = PIECES[str(rng.choice(kinds))]
        for _ in range(_TRIES_EACH // 2):
            x, y = rng.uniform(area[0], area[2]), rng.uniform(area[1], area[3])
            yaw = float(rng.integers(4)) * math.pi / 2 + rng.normal(0, 0.05)
            if _stands_free(plan, piece, x, y, yaw, gap_m, keep_free):
                piece.build(plan, x, y, yaw)
                break


def _stands_free(
    plan: FloorPlan, piece: Piece, x: float, y: float, yaw: float, gap_m: float, keep_free: KeepFree
) -> bool:
    """Whether the outline of a piece keeps a gap to what is there, and its corners stay out of `keep_free`."""
    if any(math.dist((x, y), (a, b)) < r + piece.reach_m for a, b, r in keep_free):
        return False
    cos, sin = math.cos(yaw), math.sin(yaw)
    share = np.linspace(-0.5, 0.5, 9)
    ahead, left = (grid.ravel() for grid in np.meshgrid(share * piece.depth_m, share * piece.width_m))
    points = np.stack([x + cos * ahead - sin * left, y + sin * ahead + cos * left], axis=1)
    return bool((clearances_m(plan, points, gap_m + 0.1, (0.0, math.inf)) >= gap_m).all())
