"""A world as MJCF, MuJoCo's XML: the same solids that the rays meet, for checking against it or for viewing there."""

from __future__ import annotations

import math
from xml.etree import ElementTree

import numpy as np
from jaxtyping import Float

from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.people import PARTS

_PART_NAMES = ("left-leg", "right-leg", "left-trunk", "right-trunk", "left-arm", "right-arm", "head")
_COLOURS = {
    "plane": "0.82 0.82 0.80 1",
    "box": "0.55 0.60 0.68 1",
    "pillar": "0.45 0.50 0.58 1",
    "person": "0.85 0.45 0.25 1",
}


def world_mjcf(plan: FloorPlan, bodies: Float[np.ndarray, "people parts 5"] | None = None) -> str:
    """MJCF text of a floor plan and the people in it, with the ground at z = 0 and the ceiling, if it has one.

    All solids are static geoms of the world body, in the order: ground, ceiling, boxes, pillars, people. Numbers are
    written with all their digits, so that MuJoCo reads the very same values.

    Args:
        plan: `Simulator.floor_plan(b)`.
        bodies: `Simulator.body_cylinders(b)`; cylinders without radius (nobody there) are left out.
    """
    root = ElementTree.Element("mujoco", model="densecavoid")
    ElementTree.SubElement(root, "compiler", angle="radian")
    world = ElementTree.SubElement(root, "worldbody")

    def geom(name: str, kind: str, colour: str, size: tuple[float, ...], pos: tuple[float, ...], euler: tuple) -> None:
        attributes = {"name": name, "type": kind, "rgba": _COLOURS[colour]}
        numbers = {"size": size, "pos": pos, "euler": euler}
        attributes |= {key: " ".join(repr(float(value)) for value in values) for key, values in numbers.items()}
        ElementTree.SubElement(world, "geom", attributes)

    def cylinder(name: str, colour: str, row: np.ndarray) -> None:
        x, y, radius, z_min, z_max = row
        geom(name, "cylinder", colour, (radius, (z_max - z_min) / 2), (x, y, (z_min + z_max) / 2), (0, 0, 0))

    # A plane is seen from its own upper side alone, so the ceiling is turned over; half sizes of 0 are endless.
    geom("ground", "plane", "plane", (0, 0, 1), (0, 0, 0), (0, 0, 0))
    if math.isfinite(plan.ceiling_m):
        geom("ceiling", "plane", "plane", (0, 0, 1), (0, 0, plan.ceiling_m), (math.pi, 0, 0))
    for i, (x, y, yaw, half_length, half_width, z_min, z_max) in enumerate(plan.boxes):
        size = (half_length, half_width, (z_max - z_min) / 2)
        geom(f"box-{i}", "box", "box", size, (x, y, (z_min + z_max) / 2), (0, 0, yaw))
    for i, row in enumerate(plan.cylinders):
        cylinder(f"pillar-{i}", "pillar", row)
    for i, parts in enumerate(np.zeros((0, PARTS, 5)) if bodies is None else bodies):
        for name, row in zip(_PART_NAMES, parts, strict=True):
            if row[2] > 0:
                cylinder(f"person-{i}-{name}", "person", row)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"
