"""The look that all pictures share: colours, type, and the colour scales of depth and time."""

from __future__ import annotations

from functools import cache

import matplotlib
import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image, ImageFont

Colour = tuple[int, int, int]

PAGE: Colour = (246, 247, 249)
CARD: Colour = (255, 255, 255)
BORDER: Colour = (225, 229, 234)
GRID: Colour = (240, 242, 245)
INK: Colour = (31, 41, 51)
MUTED: Colour = (123, 135, 148)
NO_DEPTH: Colour = (222, 225, 230)

WALL: Colour = (74, 85, 104)
FURNITURE: Colour = (190, 198, 207)
FURNITURE_EDGE: Colour = (154, 165, 177)
TABLE_TOP: Colour = (239, 229, 213)
TABLE_EDGE: Colour = (214, 199, 174)
PLANT: Colour = (186, 214, 178)
PLANT_EDGE: Colour = (140, 178, 130)
CROWN: Colour = (240, 247, 238)
LOW: Colour = (232, 226, 240)
LOW_EDGE: Colour = (186, 174, 206)

PERSON: Colour = (240, 138, 75)
PERSON_EDGE: Colour = (194, 97, 38)
ROBOT: Colour = (37, 99, 235)
ROBOT_EDGE: Colour = (23, 63, 156)
GOAL: Colour = (245, 184, 0)
GOAL_EDGE: Colour = (181, 131, 0)
LIDAR: Colour = (214, 51, 108)
VIEW: Colour = (147, 190, 246)
FREE_SPACE: Colour = (221, 233, 250)

OUTCOME: dict[str, Colour] = {"success": (22, 135, 84), "collision": (200, 45, 60), "timeout": (108, 117, 128)}
OUTCOME_TEXT = {"success": "reached the goal", "collision": "collision", "timeout": "out of time"}


@cache
def font(size_px: int) -> ImageFont.FreeTypeFont:
    """The type that Pillow carries with it: no system fonts, the same picture everywhere."""
    return ImageFont.load_default(size_px)  # type: ignore[return-value]


@cache
def scale(name: str, steps: int = 256) -> UInt8[np.ndarray, "steps 3"]:
    """A perceptual colour scale of matplotlib as a table."""
    colours = matplotlib.colormaps[name](np.linspace(0, 1, steps))[:, :3]
    return (colours * 255).round().astype(np.uint8)


def depth_colours(nearness: Float[np.ndarray, "..."]) -> UInt8[np.ndarray, "... 3"]:
    """Bright where something is near (1), dark where it is far (0), neutral grey where nothing is known (NaN)."""
    table = scale("viridis", 64)
    known = np.isfinite(nearness)
    index = (np.clip(np.where(known, nearness, 0.0), 0.0, 1.0) * (len(table) - 1)).round().astype(np.intp)
    return np.where(known[..., None], table[index], np.array(NO_DEPTH, np.uint8))


def blend(over: Colour, under: Colour, opacity: float) -> Colour:
    """`over` painted on `under`."""
    red, green, blue = (round(opacity * a + (1 - opacity) * b) for a, b in zip(over, under, strict=True))
    return red, green, blue


@cache
def palette_image() -> Image.Image:
    """At most 255 colours that every film frame is made of: the theme, its anti-aliased edges, the depth scale.

    One palette for a whole film: what does not move keeps its very bits from frame to frame, and costs nothing.
    """
    opacities = (0.12, 0.25, 0.4, 0.55, 0.7, 0.85, 1.0)
    lines = (INK, MUTED, WALL, PERSON, ROBOT, LIDAR, FURNITURE_EDGE, GOAL)
    tints = (FREE_SPACE, blend(VIEW, CARD, 0.32), FURNITURE, TABLE_TOP)
    colours: list[Colour] = [PAGE, CARD, BORDER, GRID, NO_DEPTH, (0, 0, 0), PERSON_EDGE, ROBOT_EDGE, GOAL_EDGE]
    colours += [FURNITURE, TABLE_TOP, TABLE_EDGE, VIEW, FREE_SPACE, PLANT, PLANT_EDGE, CROWN, LOW, LOW_EDGE]
    colours += [blend(over, CARD, opacity) for over in lines for opacity in opacities]
    colours += [blend(over, PAGE, opacity) for over in (INK, MUTED) for opacity in opacities]
    colours += [blend(CARD, under, opacity) for under in OUTCOME.values() for opacity in (0.0, 0.33, 0.66)]
    colours += [blend(over, under, a) for over in (PERSON, ROBOT, LIDAR) for under in tints for a in (0.25, 0.5, 0.75)]
    colours += [blend(VIEW, CARD, opacity) for opacity in (0.16, 0.32, 0.6)]
    colours += [(int(red), int(green), int(blue)) for red, green, blue in scale("viridis", 64)]
    table = list(dict.fromkeys(colours))
    assert len(table) <= 255, len(table)
    image = Image.new("P", (1, 1))
    image.putpalette([channel for colour in table for channel in colour])
    return image
