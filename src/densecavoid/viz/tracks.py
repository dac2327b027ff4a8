"""Tracks from above, beside the people whom they follow: `python -m densecavoid.viz.tracks OUT.png`.

Only what the robot senses is drawn of the room: the returns of its lidar.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro
from PIL import Image, ImageDraw

from densecavoid.baselines import GoToGoal
from densecavoid.frames import LidarConfig, choose, require
from densecavoid.perception.evaluation.tracker import WITHIN_M, Followed, Moment, TrackingRun, follow, record
from densecavoid.perception.sources import ImageSource
from densecavoid.scenarios.registry import names
from densecavoid.sim.config import SimConfig
from densecavoid.viz import theme
from densecavoid.viz.scene import Canvas, View, scan_hits

TRAIL_S = 3.0
_GAP, _LEGEND_PX = 8, 30
_COLOURS = ((37, 99, 235), (22, 135, 84), (147, 51, 190), (200, 45, 60), (8, 145, 178), (161, 98, 7), (190, 24, 93))
_TRACK_M = 0.33


@dataclass(frozen=True)
class TracksConfig:
    """Settings of the sheet."""

    out: tyro.conf.Positional[Path]
    """Where the picture goes."""
    scenario: str = "dense-ped"
    seed: int = 20_000
    """Decides the world."""
    columns: int = 3
    rows: int = 2
    every_s: float = 1.5
    """From one panel to the next."""
    panel_px: int = 420

    def __post_init__(self) -> None:
        choose("TracksConfig.scenario", self.scenario, names())
        for name in ("columns", "rows", "panel_px"):
            require(getattr(self, name) >= 1, f"TracksConfig.{name}", getattr(self, name), "at least 1")
        require(self.every_s > 0, "TracksConfig.every_s", self.every_s, "positive")


def tracks_panel(
    moment: Moment, followed: Sequence[Followed], lidar: LidarConfig, dt_s: float, panel_px: int
) -> Image.Image:
    """World 0 at one instant, as far as `WITHIN_M` around the robot.

    Args:
        followed: of that episode up to then; the last is now.
    """
    pose, now = moment.pose[0], followed[-1].frame
    width_m = 2.0 * WITHIN_M + 0.6
    view = View((float(pose[0]), float(pose[1])), 0, panel_px / width_m, panel_px, panel_px)
    canvas = Canvas(view)
    canvas.grid()
    canvas.disc(pose[:2], WITHIN_M, None, theme.MUTED)
    canvas.dots(scan_hits(moment.scan_m[0], lidar, pose), theme.WALL, 0.7)
    for person, place in zip(moment.person[0].tolist(), moment.person_pos[0], strict=True):
        if person >= 0 and np.abs(place - pose[:2]).max() < 0.5 * width_m:
            counts = person in now.person
            fill, edge = (theme.PERSON, theme.PERSON_EDGE) if counts else (theme.GRID, theme.MUTED)
            canvas.disc(place, 0.25, fill, edge)
    recent = followed[-max(1, round(TRAIL_S / dt_s)) :]
    for track, place in zip(now.track.tolist(), now.track_pos, strict=True):
        colour = _COLOURS[track % len(_COLOURS)]
        way = [one.frame.track_pos[one.frame.track == track] for one in recent]
        canvas.fading_track(np.concatenate(way), colour, 2.5, 1.0)
        canvas.disc(place, _TRACK_M, None, colour, edge_px=2.5)
    canvas.robot(pose, 0.18)
    for found, colour in ((moment.legs, theme.LIDAR), (moment.camera, theme.INK)):
        if found is not None:
            canvas.dots(found.pos[0, : found.count[0]], colour, 2.0)
    picture = canvas.image()
    draw = ImageDraw.Draw(picture)
    for track, place in zip(now.track.tolist(), now.track_pos, strict=True):
        x, y = view.pixels(place + 0.26).tolist()
        draw.text((x, y - 12), str(track), _COLOURS[track % len(_COLOURS)], theme.font(14))
    return picture


def tracks_sheet(
    moments: Sequence[Moment], followed: Sequence[Followed], run: TrackingRun, config: TracksConfig
) -> Image.Image:
    """Panels of the longest episode of a recording of one world, with a legend."""
    dt = run.sim.control_dt_s
    size, legend = config.panel_px, ("person who counts", "other person", "track, its number and way")
    page = Image.new("RGB", _page_size(config), theme.PAGE)
    draw = ImageDraw.Draw(page)
    colours = (theme.PERSON_EDGE, theme.MUTED, _COLOURS[0], theme.INK, theme.LIDAR)
    for k, (text, colour) in enumerate(
        zip((*legend, "found by the camera", "found by the lidar"), colours, strict=True)
    ):
        draw.text((_GAP + 240 * k, 7), text, colour, theme.font(16))
    numbers = [one.episode for one in followed]
    longest = [one for one in followed if one.episode == max(set(numbers), key=numbers.count)]
    for n in range(config.columns * config.rows):
        step = round((n + 1) * config.every_s / dt)
        if step >= len(longest):
            break
        so_far = longest[: step + 1]
        panel = tracks_panel(moments[so_far[-1].step], so_far, run.sim.lidar, dt, size)
        ImageDraw.Draw(panel).text((8, 6), f"{step * dt:.1f} s", theme.MUTED, theme.font(14))
        row, column = divmod(n, config.columns)
        page.paste(panel, (_GAP + column * (size + _GAP), _LEGEND_PX + row * (size + _GAP)))
    return page


def _page_size(config: TracksConfig) -> tuple[int, int]:
    step = config.panel_px + _GAP
    return config.columns * step + _GAP, config.rows * step + _LEGEND_PX


def main(args: Sequence[str] | None = None) -> None:
    """Draws the sheet."""
    config = tyro.cli(TracksConfig, prog="python -m densecavoid.viz.tracks", args=args)
    sim = SimConfig(sensors="real")
    # Several episodes' worth: some end soon.
    steps = 3 * round(config.columns * config.rows * config.every_s / sim.control_dt_s)
    run = TrackingRun(worlds=1, steps=steps, seed=config.seed, sim=sim)
    moments = record(config.scenario, GoToGoal(), ImageSource(sim.camera, 1), run)
    tracks_sheet(moments, follow(moments, run), run, config).save(config.out)
    print(config.out)


if __name__ == "__main__":
    main()
