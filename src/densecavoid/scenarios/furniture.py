"""Cluttered rooms: boxes, pillars, tables and chairs, set so that tight but passable gaps are common."""

from __future__ import annotations

import math

import numpy as np

from densecavoid.scenarios.free_space import Area
from densecavoid.sim.floorplan import FloorPlan

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
