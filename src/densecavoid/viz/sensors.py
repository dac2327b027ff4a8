"""What a robot's sensors show of one world: colour, classes, people, exact and real depth, and the scan from above.

`python -m densecavoid.viz.sensors sensors.png lobby` draws a world of that scenario.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float32, UInt8
from PIL import Image, ImageDraw

from densecavoid.frames import CameraConfig, Command, LidarConfig
from densecavoid.scenarios import make_scenario
from densecavoid.sim.images import CLASSES
from densecavoid.sim.spec import Scenario
from densecavoid.sim.world import SimConfig, Simulator
from densecavoid.viz import theme
from densecavoid.viz.scene import Canvas, Extent

CAMERA = CameraConfig(
    width=640, height=480, fov_horizontal_rad=math.radians(70), fov_vertical_rad=math.radians(55), max_range_m=8.0
)
"""A native resolution, for the pictures."""
LIDAR = LidarConfig(max_range_m=8.0)
_CLASS_COLOURS = np.array(
    [(226, 232, 240), (148, 163, 184), (203, 213, 225), (100, 116, 139), (125, 211, 252), (234, 122, 60)], np.uint8
)
_STEPS = 12
_MARGIN_PX, _TITLE_PX, _CELL_PX = 14, 28, (400, 300)
_AROUND_M = 6.0


def _depth_picture(
    depth_m: Float32[np.ndarray, "height width"], farthest_m: float
) -> UInt8[np.ndarray, "height width 3"]:
    """Near is light; what has no depth is dark blue."""
    nearness = np.clip(1.0 - np.nan_to_num(depth_m, nan=farthest_m) / farthest_m, 0.0, 1.0)
    grey = np.repeat((40 + 215 * nearness)[..., None], 3, axis=2)
    return np.where(np.isnan(depth_m)[..., None], np.array([23, 37, 84]), grey).astype(np.uint8)


def _people_picture(
    rgb: UInt8[np.ndarray, "height width 3"], person: Bool[np.ndarray, "height width"], number: np.ndarray
) -> UInt8[np.ndarray, "height width 3"]:
    """Each person in a colour of their own, the rest faint."""
    hue = (number[..., None] * np.array([97, 57, 151]) + np.array([90, 160, 40])) % 200 + 40
    return np.where(person[..., None], hue, 160 + rgb // 3).astype(np.uint8)


def sensor_sheet(scenario: Scenario, seed: int = 3) -> Image.Image:
    """Six panels of one world after a second of driving."""
    frames, sims = [], []
    for sensors in ("clean", "real"):
        config = SimConfig(lidar=LIDAR, camera=dataclasses.replace(CAMERA, min_range_m=0.3), sensors=sensors)
        sim = Simulator(scenario, 1, config)
        sim.reset(np.array([seed]))
        for _ in range(_STEPS):
            if not sim.done[0]:
                sim.step(Command(np.full(1, 0.5, np.float32), np.full(1, 0.15, np.float32)))
        frames.append(sim.sense())
        sims.append(sim)
    images = sims[0].images()
    rgb, segmentation = images.rgb[0], images.segmentation[0]
    person = segmentation == CLASSES.index("person")
    panels = {
        "colour": rgb,
        "exact depth": _depth_picture(frames[0].depth_m[0], CAMERA.max_range_m),
        "lidar: exact (line) and real (dots)": np.asarray(
            _scan_picture(sims[0], frames[0].scan_m[0], frames[1].scan_m[0])
        ),
        "classes": _CLASS_COLOURS[segmentation],
        "real depth: noise, shadows, dark and far surfaces": _depth_picture(frames[1].depth_m[0], CAMERA.max_range_m),
        "people, each by number": _people_picture(rgb, person, images.instance[0]),
    }
    width, height = _CELL_PX[0] + _MARGIN_PX, _CELL_PX[1] + _TITLE_PX + _MARGIN_PX
    sheet = Image.new("RGB", (3 * width + _MARGIN_PX, 2 * height + _MARGIN_PX), theme.PAGE)
    draw = ImageDraw.Draw(sheet)
    for k, (title, panel) in enumerate(panels.items()):
        x, y = _MARGIN_PX + k % 3 * width, _MARGIN_PX + k // 3 * height
        sheet.paste(Image.fromarray(panel).resize(_CELL_PX, Image.Resampling.LANCZOS), (x, y + _TITLE_PX))
        draw.text((x + 2, y + 4), title, fill=theme.INK, font=theme.font(15))
    return sheet


def _scan_picture(sim: Simulator, exact: Float32[np.ndarray, "rays"], real: Float32[np.ndarray, "rays"]) -> Image.Image:
    x, y, yaw = sim.robot_pose[0]
    half = _AROUND_M * np.array([_CELL_PX[0] / _CELL_PX[1], 1.0])
    extent = Extent((x - half[0], y - half[1]), (x + half[0], y + half[1]), 0)
    canvas = Canvas(extent.view(*_CELL_PX))
    canvas.grid()
    canvas.floor_plan(sim.floor_plan(0))
    people = sim.people()
    for k in np.flatnonzero(people.active[0]):
        canvas.person(people.pos_w[0, k].astype(np.float64), float(sim.heading_rad[0, k]), float(people.radius_m[0, k]))
    bearing = yaw + LIDAR.angles_rad
    ends = np.stack([x + np.cos(bearing) * exact, y + np.sin(bearing) * exact], axis=1)
    for a, b in itertools.pairwise(ends):
        if np.isfinite(a).all() and np.isfinite(b).all() and math.dist(a, b) < 0.4:
            canvas.line(np.stack([a, b]), theme.ROBOT, 1.5)
    for range_m, angle in zip(real, bearing, strict=True):
        if np.isfinite(range_m):
            canvas.disc(np.array([x + math.cos(angle) * range_m, y + math.sin(angle) * range_m]), 0.035, theme.INK)
    canvas.robot(np.array([x, y, yaw]), sim.config.robot.radius_m)
    return canvas.image()


def main(args: Sequence[str]) -> None:
    """Writes the picture of a scenario's world to a file."""
    out, name = Path(args[0] if args else "sensors.png"), args[1] if len(args) > 1 else "lobby"
    sensor_sheet(make_scenario(name)).save(out, optimize=True)


if __name__ == "__main__":
    main(sys.argv[1:])
