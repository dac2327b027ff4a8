"""One picture of a whole episode from above: the robot's path coloured by time among fading tracks of people."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float
from PIL import Image, ImageDraw

from densecavoid.benchmark.episode import Episode
from densecavoid.frames import RobotConfig, require
from densecavoid.viz import theme
from densecavoid.viz.scene import Canvas, extent_of

TIME_SCALE = "plasma"
TRACK_S = 6.0
"""How much of people's past is drawn behind their last place."""


def episode_picture(
    episode: Episode, width_px: int = 900, robot: RobotConfig = RobotConfig(), title: bool = True
) -> Image.Image:
    """Draws an episode as it ended, with the way that led there.

    Args:
        episode: With its floor plan; people are drawn where they were kept (`run_episodes(..., keep_people=True)`).
        width_px: Of the picture; a square room gets two thirds of it, the height follows the scene.
        robot: Whose radius is drawn.
        title: Whether to say above the scene who drove where, and how it ended.

    Raises:
        ValueError: when the episode has no floor plan.
    """
    require(episode.floor_plan is not None, "Episode.floor_plan", None, "a floor plan to draw")
    assert episode.floor_plan is not None
    extent = extent_of(episode.floor_plan, episode.pose_w[0, :2], episode.goal_w)
    width_m, height_m = extent.size_m
    width_px = width_px if extent.elongated else round(width_px * 2 / 3)
    view = extent.view(width_px, round(width_px * height_m / width_m))
    canvas = Canvas(view)
    canvas.grid()
    canvas.floor_plan(episode.floor_plan)
    canvas.goal(episode.goal_w)
    _people(canvas, episode)
    _path(canvas, episode)
    canvas.disc(episode.pose_w[0, :2], 0.6 * robot.radius_m, theme.CARD, theme.ROBOT_EDGE, edge_px=2)
    canvas.robot(episode.pose_w[-1], robot.radius_m)
    return _titled(canvas.image(), episode) if title else canvas.image()


def save_episode_picture(path: Path, episode: Episode, width_px: int = 900) -> None:
    """Writes `episode_picture` as a PNG; its folder is made."""
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    episode_picture(episode, width_px).save(path, optimize=True)


def _people(canvas: Canvas, episode: Episode) -> None:
    """Where people ended, and how they came there; who has left is a track alone."""
    if episode.people is None:
        return
    last = len(episode.time_s) - 1
    for person in np.unique(episode.people.id).tolist():
        track = episode.people.of(person)
        recent = episode.time_s[track.instant] >= episode.time_s[-1] - TRACK_S
        points = track.pos_w[recent][::-2][::-1].astype(np.float64)
        canvas.fading_track(points, theme.PERSON, 2.2, 0.8)
        if track.instant[-1] == last:
            canvas.person(track.pos_w[-1], _heading(track.pos_w), float(track.radius_m[-1]))


def _heading(track_w: Float[np.ndarray, "n 2"]) -> float | None:
    """Which way somebody last went; None for who has not moved by a hand's breadth."""
    way = track_w[-1] - track_w
    moved = np.flatnonzero(np.hypot(way[:, 0], way[:, 1]) > 0.1)
    return float(np.arctan2(way[moved[-1], 1], way[moved[-1], 0])) if len(moved) else None


def _path(canvas: Canvas, episode: Episode) -> None:
    colours = theme.scale(TIME_SCALE)
    # The far end of the scale is too pale for a line on white.
    index = np.linspace(0, 0.85 * (len(colours) - 1), len(episode.pose_w) - 1).astype(np.intp)
    for k, colour in enumerate(colours[index].tolist()):
        canvas.line(episode.pose_w[k : k + 2, :2], tuple(colour), 3.2)


def _titled(scene: Image.Image, episode: Episode) -> Image.Image:
    margin, title = 12, 44
    page = Image.new("RGB", (scene.width + 2 * margin, scene.height + title + margin), theme.PAGE)
    page.paste(scene, (margin, title))
    draw = ImageDraw.Draw(page)
    draw.rectangle((margin - 1, title - 1, margin + scene.width, title + scene.height), outline=theme.BORDER)
    middle = title // 2
    draw.text((margin + 2, middle), episode.navigator, theme.INK, theme.font(18), anchor="lm")
    left = margin + 10 + draw.textlength(episode.navigator, theme.font(18))
    draw.text((left, middle), f"{episode.scenario}, seed {episode.seed}", theme.MUTED, theme.font(14), anchor="lm")
    right = margin + scene.width - 2
    text = f"{theme.OUTCOME_TEXT[episode.outcome]}, {episode.duration_s:.1f} s"
    draw.text((right, middle), text, theme.OUTCOME[episode.outcome], theme.font(15), anchor="rm")
    colours = theme.scale(TIME_SCALE)
    bar = colours[np.linspace(0, 0.85 * (len(colours) - 1), 60).astype(np.intp)]
    bar_right = round(right - draw.textlength(text, theme.font(15))) - 10
    page.paste(Image.fromarray(np.repeat(bar[None], 5, axis=0)), (bar_right - 60, middle - 2))
    return page
