"""Worlds seen from above as they begin: one picture of each, and a sheet of many. Knows no episodes.

`python -m densecavoid.viz.worlds worlds.png` draws all families, with names of scenarios behind it those.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from densecavoid.frames import RobotConfig
from densecavoid.scenarios import PLACES, TESTING, TRAINING, make_scenario
from densecavoid.sim.spec import Scenario, WorldSpec
from densecavoid.viz import theme
from densecavoid.viz.scene import Canvas, Extent

_SEED = 3
_MARGIN_PX = 14
_TITLE_PX = 30


def whole_extent(spec: WorldSpec) -> Extent:
    """All that stands in a world, and everybody near it."""
    boxes, cylinders = spec.floor_plan.boxes, spec.floor_plan.cylinders
    half = spec.floor_plan.box_reach
    standing = cylinders[cylinders[:, 3] < 2.0]
    radius = np.repeat(standing[:, 2:3], 2, axis=1)
    ends = np.array([spec.start_pose[:2], spec.goal])
    low = np.concatenate([boxes[:, :2] - half, standing[:, :2] - radius, ends - 1.0]).min(axis=0) - 0.2
    high = np.concatenate([boxes[:, :2] + half, standing[:, :2] + radius, ends + 1.0]).max(axis=0) + 0.2
    turns = 1 if high[1] - low[1] > 1.3 * (high[0] - low[0]) else 0
    return Extent((float(low[0]), float(low[1])), (float(high[0]), float(high[1])), turns)


def world_picture(spec: WorldSpec, width_px: int, height_px: int) -> Image.Image:
    """One world from above: the robot, its way points and goal, people with a tick towards where they go or look."""
    canvas = Canvas(whole_extent(spec).view(width_px, height_px))
    canvas.grid()
    canvas.floor_plan(spec.floor_plan)
    way = np.vstack([spec.start_pose[:2], spec.waypoints, spec.goal])
    canvas.line(way, theme.ROBOT, 1.2, 0.35)
    canvas.goal(np.array(spec.goal))
    canvas.robot(np.array(spec.start_pose), RobotConfig().radius_m)
    crowd = spec.crowd
    if spec.appearance is None:
        heading = crowd.first_heading_rad
        for k in range(crowd.size):
            canvas.person(crowd.pos[k], float(heading[k]), float(crowd.radius_m[k]))
    return canvas.image()


def contact_sheet(
    scenarios: Sequence[Scenario], seed: int = _SEED, columns: int = 3, cell_px: tuple[int, int] = (420, 330)
) -> Image.Image:
    """A world of each scenario with its name."""
    rows = math.ceil(len(scenarios) / columns)
    width, height = cell_px[0] + _MARGIN_PX, cell_px[1] + _TITLE_PX + _MARGIN_PX
    sheet = Image.new("RGB", (columns * width + _MARGIN_PX, rows * height + _MARGIN_PX), theme.PAGE)
    draw = ImageDraw.Draw(sheet)
    for k, scenario in enumerate(scenarios):
        x, y = _MARGIN_PX + k % columns * width, _MARGIN_PX + k // columns * height
        spec = scenario.spawn(np.random.default_rng(seed))
        sheet.paste(world_picture(spec, *cell_px), (x, y + _TITLE_PX))
        draw.text((x + 2, y + 4), scenario.name, fill=theme.INK, font=theme.font(17))
    return sheet


def main(args: Sequence[str]) -> None:
    """Writes the picture of the named scenarios' worlds, or of all families, to a file."""
    out, names = Path(args[0] if args else "worlds.png"), args[1:]
    if len(names) == 1:
        image = world_picture(make_scenario(names[0]).spawn(np.random.default_rng(_SEED)), 1200, 720)
    else:
        families: list[Scenario] = [*PLACES.values(), *TRAINING.values(), *TESTING.values()][:-2]  # one of freezing
        image = contact_sheet([make_scenario(name) for name in names] or families)
    image.quantize(160, dither=Image.Dither.NONE).save(out, optimize=True)


if __name__ == "__main__":
    main(sys.argv[1:])
