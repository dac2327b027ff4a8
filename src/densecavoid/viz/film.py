"""Films of an episode, GIF or MP4: the scene from above, beside it what the robot senses and expects."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image, ImageDraw

from densecavoid.benchmark.episode import OUTCOMES, Episode
from densecavoid.benchmark.rollout import run_episodes
from densecavoid.env.observation import Observer, ObserverConfig
from densecavoid.frames import CameraConfig, Command, LidarConfig, Navigator, Observation, SensorFrame, choose, require
from densecavoid.perception.config import PeopleFrom
from densecavoid.sim.world import Simulator
from densecavoid.viz import theme
from densecavoid.viz.page import (
    GAP,
    LABEL,
    PAD,
    TITLE,
    Box,
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
from densecavoid.viz.scene import Canvas, Extent, extent_of, scan_hits
from densecavoid.viz.sinks import SUFFIXES, open_sink


@dataclass(frozen=True)
class FilmConfig:
    """How an episode becomes a film."""

    width_px: int = 900
    height_px: int = 520
    hold_s: float = 1.5
    """How long the last picture stays."""
    track_s: float = 2.5
    """How much of people's past is drawn."""

    def __post_init__(self) -> None:
        # Even, because MP4 halves the resolution of colour.
        for name, least in (("width_px", 480), ("height_px", 320)):
            value = getattr(self, name)
            require(value >= least and value % 2 == 0, f"FilmConfig.{name}", value, f"even, {least} or more")
        for name in ("hold_s", "track_s"):
            require(getattr(self, name) >= 0, f"FilmConfig.{name}", getattr(self, name), "0 or more")


def film_episode(
    simulator: Simulator, navigator: Navigator, seed: int, path: Path, config: FilmConfig | None = None
) -> Episode:
    """Runs one episode in a simulator of one world and films it.

    Args:
        simulator: Of one world.
        navigator: The driver.
        seed: Of the world.
        path: Where the film goes, .gif or .mp4.
        config: How it looks.

    Returns:
        The episode, with people's tracks.
    """
    require(simulator.num_worlds == 1, "num_worlds of the simulator to film", simulator.num_worlds, "1")
    film = Film(path, navigator, config)
    try:
        (episode,) = run_episodes(simulator, navigator, [seed], on_step=film.record, keep_people=True)
        film.finish(episode.outcome)
    finally:
        film.close()
    return episode


class Film:
    """Records world 0 of a simulator step by step (`record` is a rollout.OnStep), from one reset to the end."""

    def __init__(self, path: Path, navigator: Navigator, config: FilmConfig | None = None) -> None:
        """Opens nothing yet: the first step says how large the world is.

        Raises:
            ValueError: for a file name that ends neither in .gif nor in .mp4.
        """
        choose("ending of a film's name", Path(path).suffix.lower(), SUFFIXES)
        self.path = Path(path)
        self._navigator = navigator
        self._config = config or FilmConfig()
        self._stage: _Stage | None = None
        self._simulator: Simulator | None = None
        self._observer: Observer | None = None
        self._sink = None
        self._last: Observation | None = None

    def record(self, simulator: Simulator, frame: SensorFrame, command: Command) -> None:
        """Takes a picture of what `frame` was sensed from; call it before the step is carried out."""
        if self._observer is None:
            self._observer = self._begin(simulator)
        self._last = self._observer.observe(frame)
        self._take(self._last, frame, None)

    def finish(self, outcome: str) -> None:
        """Takes the last picture, of the simulator as it stands, and writes how the episode ended.

        Raises:
            ValueError: when nothing has been recorded, or for an unknown outcome.
        """
        choose("outcome", outcome, OUTCOMES)
        require(self._last is not None, "Film.finish", "called", "after at least one recorded step")
        assert self._last is not None and self._simulator is not None and self._sink is not None
        # The observer has not seen this instant; its last prediction is a step old, the sensors are not.
        self._take(self._last, self._simulator.sense(), outcome)
        self._sink.close(hold_s=self._config.hold_s)
        self._sink = None

    def close(self) -> None:
        """Gives up a film that was not finished; after `finish` it does nothing."""
        if self._sink is not None:
            self._sink.abandon()
            self._sink = None

    def _begin(self, simulator: Simulator) -> Observer:
        """Opens the film, and makes the film's own observer: what a navigator sees is its own affair."""
        config = self._config
        self._simulator = simulator
        self._stage = _Stage(simulator, self._navigator.name, config)
        self._sink = open_sink(self.path, (config.width_px, config.height_px), simulator.config.control_dt_s)
        sensors = simulator.config
        # What is shown is what a policy is shown; for those who see no people it is where people truly are.
        people_from: PeopleFrom = getattr(self._navigator, "people_from", "truth")
        observer = ObserverConfig(lidar=sensors.lidar, camera=sensors.camera, people_from=people_from)
        return Observer(observer, simulator.num_worlds)

    def _take(self, observation: Observation, frame: SensorFrame, outcome: str | None) -> None:
        assert self._stage is not None and self._simulator is not None and self._sink is not None
        self._sink.add(self._stage.picture(self._simulator, frame, observation.prediction[0], outcome))


@dataclass(frozen=True)
class _Layout:
    """Where everything is: the scene on the left or, of a long corridor, across the page."""

    scene: Box
    depth: Box
    prediction: Box
    lidar: Box


def _layout(extent: Extent, width: int, height: int) -> _Layout:
    inner_width, inner_height = width - 2 * GAP, height - TITLE - GAP
    if extent.elongated:
        width_m, height_m = extent.size_m
        across = round(min((inner_width - 2 * PAD) * height_m / width_m + 2 * PAD, 0.55 * inner_height))
        top = TITLE + across + GAP
        third = (inner_width - 2 * GAP) // 3
        below = height - GAP - top
        cards = [(GAP + k * (third + GAP), top, third, below) for k in range(3)]
        return _Layout((GAP, TITLE, inner_width, across), *cards)
    side = min(inner_height, round(0.55 * inner_width))
    left = GAP + side + GAP
    right_width = width - GAP - left
    half = (right_width - GAP) // 2
    upper = round((half - 2 * PAD) * 0.75) + LABEL + PAD
    lower = TITLE + upper + GAP
    return _Layout(
        (GAP, TITLE, side, inner_height),
        (left, TITLE, half, upper),
        (left + half + GAP, TITLE, half, upper),
        (left, lower, right_width, height - GAP - lower),
    )


class _Stage:
    """Draws the pictures of one episode; what does not move is drawn once."""

    def __init__(self, simulator: Simulator, navigator: str, config: FilmConfig) -> None:
        self._robot_radius_m = simulator.config.robot.radius_m
        self._camera = simulator.config.camera
        self._lidar = simulator.config.lidar
        plan, goal = simulator.floor_plan(0), simulator.goal[0].copy()
        extent = extent_of(plan, simulator.start_pose[0, :2], goal)
        layout = _layout(extent, config.width_px, config.height_px)
        self._scene_box = inset(layout.scene, PAD, PAD)
        self._depth_box = fitted(inset(layout.depth, PAD, LABEL), 4 / 3)
        self._prediction_box = fitted(inset(layout.prediction, PAD, LABEL), 4 / 3)
        self._lidar_box = inset(layout.lidar, PAD, LABEL)
        self._view = extent.view(*self._scene_box[2:])
        self._lidar_picture = LidarPicture(self._lidar, self._lidar_box[2:])
        floor = Canvas(self._view)
        floor.grid()
        floor.floor_plan(plan)
        floor.goal(goal)
        self._floor = floor.enlarged_image
        self._page = _page(layout, config, navigator, simulator.scenario_name[0], self._camera, self._lidar)
        self._width = config.width_px
        steps = round(config.track_s / simulator.config.control_dt_s)
        self._tracks_length = steps + 1
        self._tracks: dict[int, deque[np.ndarray]] = {}
        self._path: list[np.ndarray] = []

    def picture(
        self,
        simulator: Simulator,
        frame: SensorFrame,
        prediction: UInt8[np.ndarray, "height width"],
        outcome: str | None,
    ) -> Image.Image:
        """The page at this instant."""
        page = self._page.copy()
        page.paste(self._scene(simulator, frame), self._scene_box[:2])
        page.paste(depth_picture(frame.depth_m[0], self._camera, self._depth_box[2:]), self._depth_box[:2])
        left, top, width, height = self._prediction_box
        page.paste(prediction_picture(prediction, (width, height)), (left, top))
        ImageDraw.Draw(page).rectangle((left, top, left + width - 1, top + height - 1), outline=theme.BORDER)
        page.paste(self._lidar_picture.draw(frame.scan_m[0]), self._lidar_box[:2])
        # Right-aligned in fixed columns, so that the figures do not dance.
        right = self._width - GAP - 2
        figure(page, right, f"{simulator.robot_velocity[0, 0]:.2f} m/s")
        figure(page, right - 96, f"{simulator.time_s[0]:.1f} s")
        if outcome is not None:
            pill(page, right - 176, theme.OUTCOME_TEXT[outcome], theme.OUTCOME[outcome])
        return page

    def _scene(self, simulator: Simulator, frame: SensorFrame) -> Image.Image:
        pose = simulator.robot_pose[0].copy()
        people = simulator.people()
        here = np.flatnonzero(people.active[0])
        self._path.append(pose[:2])
        self._remember({int(people.id[0, k]): people.pos_w[0, k] for k in here})

        canvas = Canvas(self._view, self._floor)
        canvas.region(seen_area(frame, self._camera, self._lidar, pose), theme.VIEW, 0.32)
        for track in self._tracks.values():
            # Every other point is enough for a smooth line of slow people.
            canvas.fading_track(np.array(list(track)[::-2][::-1]), theme.PERSON, 2.0, 0.8)
        canvas.line(np.array(self._path), theme.ROBOT, 2.4, 0.75)
        for k in here:
            canvas.person(people.pos_w[0, k], float(simulator.heading_rad[0, k]), float(people.radius_m[0, k]))
        canvas.dots(scan_hits(frame.scan_m[0], self._lidar, pose)[::2], theme.LIDAR, 0.7)
        canvas.robot(pose, self._robot_radius_m)
        return canvas.image()

    def _remember(self, places: dict[int, np.ndarray]) -> None:
        """Goes on with the tracks of those who are here, and forgets the others."""
        known = self._tracks
        self._tracks = {who: known.get(who, deque(maxlen=self._tracks_length)) for who in places}
        for who, place in places.items():
            self._tracks[who].append(place)


def seen_area(
    frame: SensorFrame, camera: CameraConfig, lidar: LidarConfig, pose_w: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "n 2"]:
    """Outline of the ground that the camera of world 0 looks over, as its middle row tells.

    No depth means too near as well as too far; the scan at the same bearing says which.
    """
    slopes = camera.column_slopes
    stretch, bearings = np.hypot(1.0, slopes), np.arctan(slopes)
    ray = np.abs(lidar.angles_rad[None] - bearings[:, None]).argmin(axis=1)
    too_near = frame.scan_m[0, ray] < camera.min_range_m * stretch
    unknown = np.where(too_near, camera.min_range_m, camera.max_range_m)
    row = frame.depth_m[0, camera.height // 2]
    depth = np.where(np.isfinite(row), row, unknown)
    angles = pose_w[2] + bearings
    rim = np.stack([np.cos(angles), np.sin(angles)], axis=-1) * stretch[:, None]
    return pose_w[:2] + np.concatenate([camera.min_range_m * rim, (depth[:, None] * rim)[::-1]])


def _page(
    layout: _Layout, config: FilmConfig, navigator: str, scenario: str, camera: CameraConfig, lidar: LidarConfig
) -> Image.Image:
    """Title, cards and labels: all that stays the same."""
    page = blank_page(
        (config.width_px, config.height_px), (layout.scene, layout.depth, layout.prediction, layout.lidar)
    )
    title(page, navigator, scenario)
    label(page, layout.depth, "depth")
    depth_scale(page, layout.depth, camera)
    label(page, layout.prediction, "prediction", "expected people")
    label(page, layout.lidar, "lidar", f"{lidar.max_range_m:g} m")
    return page
