"""What things are made of: how they look, how well they return a sensor's infrared light, and whether it passes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32

from densecavoid.frames import choose, require


@dataclass(frozen=True)
class Material:
    """One material."""

    name: str
    colour: tuple[float, float, float]
    """Red, green and blue of its diffuse reflection, 0 to 1."""
    infrared: float
    """Share of the light of a lidar or a depth camera (about 800 to 900 nm) that it reflects, 0 to 1."""
    see_through: bool = False
    """Sensors look through it, but for what glass itself returns (noise.py); it can be hit all the same."""

    def __post_init__(self) -> None:
        require(all(0 <= part <= 1 for part in self.colour), "Material.colour", self.colour, "three numbers in [0, 1]")
        require(0 <= self.infrared <= 1, "Material.infrared", self.infrared, "in [0, 1]")


MATERIALS: tuple[Material, ...] = (
    Material("plaster", (0.84, 0.83, 0.80), 0.80),
    Material("wood", (0.58, 0.42, 0.27), 0.60),
    Material("concrete", (0.56, 0.55, 0.53), 0.40),
    Material("metal", (0.48, 0.51, 0.55), 0.50),
    Material("plastic", (0.22, 0.42, 0.60), 0.50),
    Material("fabric", (0.50, 0.24, 0.22), 0.40),
    Material("plant", (0.25, 0.42, 0.20), 0.50),
    Material("black", (0.05, 0.05, 0.06), 0.04),
    Material("glass", (0.62, 0.75, 0.76), 0.05, see_through=True),
)
"""Reflectances are round figures for 850 to 905 nm, assumed: white walls .8, wood .6, black lacquer or leather .04."""

_NUMBER = {material.name: number for number, material in enumerate(MATERIALS)}
GLASS = _NUMBER["glass"]


def material_number(name: str) -> int:
    """Where a material stands in `MATERIALS`.

    Raises:
        ValueError: naming those there are.
    """
    number = _NUMBER.get(name)  # asked for each thing in each world
    return _NUMBER[choose("material", name, tuple(_NUMBER))] if number is None else number


def material_colours() -> Float32[np.ndarray, "materials 3"]:
    """Red, green and blue of each material."""
    return np.array([material.colour for material in MATERIALS], np.float32)


def material_infrared() -> Float32[np.ndarray, "materials"]:
    """Infrared reflectance of each material."""
    return np.array([material.infrared for material in MATERIALS], np.float32)
