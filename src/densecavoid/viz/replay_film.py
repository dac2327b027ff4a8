"""Films of recordings in the robot's loop: what is sensed, who is tracked and where they will be, what the wheels get.

There is no floor plan and no truth in a recording: only what the robot's own loop knows is drawn.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from densecavoid.frames import CameraConfig, SensorFrame, choose
from densecavoid.perception.predictor.contract import ROBOT_HORIZONS_S
from densecavoid.perception.tracks import HISTORY
from densecavoid.robot.config import RobotSettings
from densecavoid.robot.folder import FolderPilot
from densecavoid.robot.replay import Moment, ReplayConfig, ReplaySummary, replay
from densecavoid.safety import SafeCommand
from densecavoid.viz import theme
from densecavoid.viz.film import FilmConfig, seen_area
from densecavoid.viz.gauges import Gauge, Velocity
from densecavoid.viz.page import (
    GAP,
    LABEL,
    PAD,
    TITLE,
    blank_page,
    depth_scale,
    figure,
    fitted,
    inset,
    label,
    pill,
    title,
)
from densecavoid.viz.panels import LidarPicture, depth_picture, prediction_picture
from densecavoid.viz.scene import Canvas, View, scan_hits
from densecavoid.viz.sinks import SUFFIXES, Sink, open_sink

FRAME_S = 0.1
"""From picture to picture: as often as the policy decides."""
_COURSE_S = 10.0
"""Of commands shown."""
_LEADS_S = 1.5
"""How far ahead the command's arc is drawn."""
_AROUND_M = 0.3
"""Shown beyond the lidar's range."""
_HORIZONS_S = ROBOT_HORIZONS_S[1:]
_ROBOT_RADIUS_M = 0.18
_LEVELS = ("success", "timeout", "collision")
"""Whose colours say fine, slowed down, stopped by a fault."""


def film_replay(config: ReplayConfig) -> ReplaySummary:
    """Runs a recording (`robot.replay.replay`) and films it, unless the configuration wants no film.

    Raises:
        ValueError: as `replay`.
    """
    if config.film_path is None:
        return replay(config)
    film = ReplayFilm(config.film_path, config.bag.name)
    try:
        summary = replay(config, film.record)
        film.finish()
    finally:
        film.close()
    return summary


class ReplayFilm:
    """Takes a picture every `FRAME_S` of the moments that it is shown (`record` is a `replay.OnStep`)."""

    def __init__(self, path: Path, recording: str, config: FilmConfig | None = None) -> None:
        """Opens nothing yet: the first moment says what the robot has.

        Args:
            path: where the film goes, .gif or .mp4.
            recording: its name, for the title.
            config: how large it is.

        Raises:
            ValueError: for a file name that ends in neither.
        """
        choose("ending of a film's name", path.suffix.lower(), SUFFIXES)
        self.path, self._recording, self._config = path, recording, config or FilmConfig()
        self._stage: _Stage | None = None
        self._sink: Sink | None = None
        self._due_s = 0.0

    def record(self, moment: Moment) -> None:
        """Takes a picture if it is time for one. Of holes in the recording there are none."""
        if moment.time_s < self._due_s - 1e-6:
            return
        self._due_s = max(self._due_s + FRAME_S, moment.time_s)
        if self._stage is None or self._sink is None:
            self._stage = _Stage(moment.pilot, moment.settings, self._recording, self._config)
            self._sink = open_sink(self.path, (self._config.width_px, self._config.height_px), FRAME_S)
        self._sink.add(self._stage.picture(moment))

    def finish(self) -> None:
        """Writes the film; without a single moment there is none."""
        if self._sink is not None:
            self._sink.close(hold_s=0.0)
            self._sink = None

    def close(self) -> None:
        """Gives up a film that was not finished; after `finish` it does nothing."""
        if self._sink is not None:
            self._sink.abandon()
            self._sink = None


class _Stage:
    """Draws the pictures of one recording; owns the robot's path and the commands' course."""

    def __init__(self, pilot: FolderPilot, settings: RobotSettings, recording: str, config: FilmConfig) -> None:
        self._camera, self._lidar = pilot.camera, pilot.lidar
        self._has_camera = settings.use_camera
        size = config.width_px, config.height_px
        side = min(size[1] - TITLE - GAP, round(0.55 * (size[0] - 2 * GAP)))
        scene = GAP, TITLE, side, size[1] - TITLE - GAP
        left = GAP + side + GAP
        half = (size[0] - left - 2 * GAP) // 2
        upper = round((half - 2 * PAD) * 0.75) + LABEL + PAD
        senses, prediction = (left, TITLE, half, upper), (left + half + GAP, TITLE, half, upper)
        lower = TITLE + upper + GAP
        commands = left, lower, 2 * half + GAP, size[1] - GAP - lower
        self._page = _page(size, (scene, senses, prediction, commands), pilot, self._has_camera, recording)
        self._width = size[0]
        self._scene_box = inset(scene, PAD, PAD)
        below = inset(senses, PAD, LABEL)
        self._senses: Callable[[SensorFrame], Image.Image]
        if self._has_camera:
            self._senses_box = fitted(below, 4 / 3)
            self._senses = _depth_of(self._camera, self._senses_box[2:])
        else:
            self._senses_box = below
            scans = LidarPicture(self._lidar, below[2:])
            self._senses = lambda sensed: scans.draw(sensed.scan_m[0])
        self._prediction_box = fitted(inset(prediction, PAD, LABEL), 4 / 3)
        left, top, width, height = inset(commands, PAD + 2, LABEL)
        half = (height - GAP) // 2
        self._gauge_boxes = (left, top + 2, width, half), (left, top + 2 + half + GAP, width, half - 2)
        self._reason_place = commands[0] + commands[2] - PAD - 1, commands[1] + LABEL // 2 + 1
        limits, keep = settings.safety, round(_COURSE_S / FRAME_S)
        turn = limits.max_angular_velocity
        self._gauges = (
            Gauge("forward", "m/s", 0.0, limits.max_linear_velocity, keep),
            Gauge("turning left (+)", "rad/s", turn, -turn, keep),
        )
        self._path: list[np.ndarray] = []

    def picture(self, moment: Moment) -> Image.Image:
        """The page at this instant."""
        page, step = self._page.copy(), moment.step
        if moment.sensed is not None:
            page.paste(self._scene(moment, moment.sensed), self._scene_box[:2])
            page.paste(self._senses(moment.sensed), self._senses_box[:2])
        prediction = moment.pilot.prediction()
        left, top, width, height = self._prediction_box
        if prediction is not None:
            page.paste(prediction_picture(prediction, (width, height)), (left, top))
        ImageDraw.Draw(page).rectangle((left, top, left + width - 1, top + height - 1), outline=theme.BORDER)
        command = step.command
        given = command.linear_velocity, command.angular_velocity
        for gauge, box, asked, gets in zip(self._gauges, self._gauge_boxes, step.asked, given, strict=True):
            gauge.draw(page, box, Velocity(asked, gets))
        reason = _shortened(step.message, 12, self._gauge_boxes[0][2] - 90)
        ImageDraw.Draw(page).text(self._reason_place, reason, theme.MUTED, theme.font(12), anchor="rm")
        right = self._width - GAP - 2
        figure(page, right, f"{moment.time_s:.1f} s")
        figure(
            page, right - 76, "no goal" if math.isnan(step.goal_distance_m) else f"{step.goal_distance_m:.1f} m to go"
        )
        pill(page, right - 196, "fault" if step.fault else command.action, theme.OUTCOME[_LEVELS[step.level]])
        return page

    def _scene(self, moment: Moment, sensed: SensorFrame) -> Image.Image:
        """From above, the robot in the middle, the odometry's x axis to the right."""
        width, height = self._scene_box[2:]
        pose = sensed.odom_pose[0]
        if not self._path or math.dist(self._path[-1], pose[:2]) > 0.02:
            self._path.append(pose[:2].copy())
        across_m = 2.0 * (self._lidar.max_range_m + _AROUND_M)
        canvas = Canvas(View((float(pose[0]), float(pose[1])), 0, min(width, height) / across_m, width, height))
        canvas.grid()
        if self._has_camera:
            canvas.region(seen_area(sensed, self._camera, self._lidar, pose), theme.VIEW, 0.32)
        canvas.disc(pose[:2], self._lidar.max_range_m, None, theme.BORDER)
        goal = moment.step.goal_odom
        if goal is not None:
            canvas.line(np.array([pose[:2], goal]), theme.GOAL, 1.5, 0.8)
            canvas.goal(np.array(goal))
        canvas.line(np.array(self._path), theme.ROBOT, 2.0, 0.5)
        canvas.line(_arc(pose, moment.step.command), theme.ROBOT, 3.0, 0.9)
        self._people(canvas, moment.pilot)
        canvas.dots(scan_hits(sensed.scan_m[0], self._lidar, pose), theme.LIDAR, 0.9)
        canvas.robot(pose, _ROBOT_RADIUS_M)
        picture = canvas.image()
        draw = ImageDraw.Draw(picture)
        draw.text((4, height - 4), "people tracked and expected, grid 1 m", theme.MUTED, theme.font(12), anchor="ls")
        return picture

    @staticmethod
    def _people(canvas: Canvas, pilot: FolderPilot) -> None:
        """Whoever is surely a person: the way come, the place, and where the predictor expects them, ever fainter."""
        tracks, expected = pilot.tracks, pilot.expected(_HORIZONS_S)
        for slot, ahead in zip(np.flatnonzero(tracks.confirmed[0]), expected.pos, strict=True):
            place, radius_m = tracks.state[0, slot, :2], float(tracks.body[0, slot, 0])
            way = tracks.history[0, slot, HISTORY - tracks.history_count[0, slot] :].astype(np.float64)
            canvas.fading_track(np.concatenate([way, place[None]]), theme.PERSON, 2.5, 0.8)
            for k in range(len(ahead))[::-1]:
                canvas.disc(ahead[k], radius_m, theme.PERSON, opacity=0.32 / (k + 1))
            canvas.line(np.concatenate([place[None], ahead]), theme.PERSON_EDGE, 1.5)
            canvas.disc(place, radius_m, theme.PERSON, theme.PERSON_EDGE, opacity=0.55, edge_px=1.5)


def _depth_of(camera: CameraConfig, size_px: tuple[int, int]) -> Callable[[SensorFrame], Image.Image]:
    return lambda sensed: depth_picture(sensed.depth_m[0], camera, size_px)


def _page(
    size_px: tuple[int, int],
    cards: tuple[tuple[int, int, int, int], ...],
    pilot: FolderPilot,
    has_camera: bool,
    recording: str,
) -> Image.Image:
    """Title, cards and labels: all that stays the same."""
    page = blank_page(size_px, cards)
    title(page, pilot.name, _shortened(recording, 16, 300))
    _, senses, prediction, commands = cards
    label(page, senses, "depth" if has_camera else "lidar", "" if has_camera else f"{pilot.lidar.max_range_m:g} m")
    if has_camera:
        depth_scale(page, senses, pilot.camera)
    label(page, prediction, "prediction", "expected people")
    label(page, commands, "command")
    return page


def _arc(pose: np.ndarray, command: SafeCommand) -> np.ndarray:
    """Where the command would lead, [n, 2] in the frame of the pose (exact motion at constant velocities)."""
    time_s = np.linspace(0.0, _LEADS_S, 16)
    linear, angular = command.linear_velocity, command.angular_velocity
    # The chord of an arc: its length is that of the way times sinc of half the turn.
    turned = angular * time_s
    chord = linear * time_s * np.sinc(turned / (2.0 * np.pi))
    bearing = pose[2] + turned / 2.0
    return pose[:2] + chord[:, None] * np.stack([np.cos(bearing), np.sin(bearing)], axis=1)


def _shortened(text: str, size_px: int, width_px: float) -> str:
    """The text, or as much of its beginning as fits."""
    font = theme.font(size_px)
    if font.getlength(text) <= width_px:
        return text
    while text and font.getlength(text + "...") > width_px:
        text = text[:-1]
    return text + "..."
