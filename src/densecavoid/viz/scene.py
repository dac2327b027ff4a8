"""A world seen from above: which part of it, at what scale, how each thing is drawn. Knows pixels, not episodes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from PIL import Image, ImageDraw

from densecavoid.frames import LidarConfig
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.mesh_contact import GROUND_M
from densecavoid.sim.people import half_depth
from densecavoid.viz import theme

SUPERSAMPLING = 3
"""Drawn so many times larger and then averaged, which smooths every edge."""
_HEAD_RADIUS_M = 0.09

WHOLE_ROOM_M = 12.5
"""A plan no longer than this is shown whole; of a longer one, what lies around the start and the goal."""
AROUND_M = 2.5
WALL_HEIGHT_M = 1.8
"""What is higher is drawn as a wall, what is lower as furniture, what begins above it not at all."""
LOW_M = 0.2
"""Kerbs and ramps, which the lidar looks over."""


@dataclass(frozen=True)
class View:
    """A rectangle of the world on a rectangle of pixels, turned by quarters so that the way leads to the right."""

    centre_w: tuple[float, float]
    quarter_turns: int
    """How far the world is turned clockwise on the picture."""
    pixels_per_m: float
    width_px: int
    height_px: int

    @property
    def size_px(self) -> tuple[int, int]:
        return self.width_px, self.height_px

    @cached_property
    def _axes(self) -> Float[np.ndarray, "2 2"]:
        """Columns: where the world's x and y axes point on the picture (right, down)."""
        turn = -self.quarter_turns * math.pi / 2
        cos, sin = round(math.cos(turn)), round(math.sin(turn))
        return np.array([[cos, -sin], [-sin, -cos]], np.float64)

    def pixels(self, points_w: Float[np.ndarray, "... 2"]) -> Float[np.ndarray, "... 2"]:
        """Where world points fall, (right, down) from the upper left corner."""
        offset = (np.asarray(points_w, np.float64) - self.centre_w) @ self._axes.T
        return offset * self.pixels_per_m + np.array([self.width_px, self.height_px]) / 2

    def enlarged(self, times: float) -> View:
        """The same part of the world on more pixels."""
        return View(
            self.centre_w,
            self.quarter_turns,
            self.pixels_per_m * times,
            round(self.width_px * times),
            round(self.height_px * times),
        )


@dataclass(frozen=True)
class Extent:
    """The part of a world worth showing, and which way up."""

    low_w: tuple[float, float]
    high_w: tuple[float, float]
    quarter_turns: int

    @property
    def size_m(self) -> tuple[float, float]:
        """Width and height on the picture."""
        size = self.high_w[0] - self.low_w[0], self.high_w[1] - self.low_w[1]
        return size if self.quarter_turns % 2 == 0 else (size[1], size[0])

    @property
    def elongated(self) -> bool:
        """Whether it is better shown across the full width of a page."""
        return self.size_m[0] > 1.7 * self.size_m[1]

    def view(self, width_px: int, height_px: int) -> View:
        """The largest view of all of it in so many pixels."""
        width_m, height_m = self.size_m
        centre = (self.low_w[0] + self.high_w[0]) / 2, (self.low_w[1] + self.high_w[1]) / 2
        return View(centre, self.quarter_turns, min(width_px / width_m, height_px / height_m), width_px, height_px)


def extent_of(plan: FloorPlan, start_w: Float[np.ndarray, "2"], goal_w: Float[np.ndarray, "2"]) -> Extent:
    """What to show of a world: all of a room, and of a long corridor the robot's way and what is around it."""
    way_low, way_high = np.minimum(start_w, goal_w), np.maximum(start_w, goal_w)
    corners = [outline[0] for outline in _outlines(plan)]
    points = np.concatenate(corners) if corners else np.stack([way_low - AROUND_M, way_high + AROUND_M])
    low, high = points.min(axis=0) - 0.15, points.max(axis=0) + 0.15
    long_axes = high - low > WHOLE_ROOM_M
    low = np.where(long_axes, np.maximum(low, way_low - AROUND_M), low)
    high = np.where(long_axes, np.minimum(high, way_high + AROUND_M), high)
    # The robot may start outside the walls (recorded corridors have open ends).
    low, high = np.minimum(low, way_low - 0.6), np.maximum(high, way_high + 0.6)
    size = high - low
    turns = 0
    if max(size) > 1.7 * min(size):
        along = int(np.argmax(size))
        backwards = goal_w[along] < start_w[along]
        turns = (1 if along == 1 else 0) + (2 if backwards else 0)
    return Extent((float(low[0]), float(low[1])), (float(high[0]), float(high[1])), turns)


def scan_hits(
    scan_m: Float[np.ndarray, "rays"], lidar: LidarConfig, pose_w: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "n 2"]:
    """Where the rays of a level scanner end that hit something, for a robot at a pose."""
    hit = np.isfinite(scan_m)
    bearing = pose_w[2] + lidar.angles_rad[hit]
    mount = pose_w[:2] + lidar.mount_x_m * np.array([math.cos(pose_w[2]), math.sin(pose_w[2])])
    return mount + scan_m[hit, None] * np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)


class Canvas:
    """An enlarged picture of a view that is drawn on in world metres and handed out anti-aliased."""

    def __init__(self, view: View, background: Image.Image | None = None) -> None:
        """Begins with `background` (an `enlarged_image`), or with an empty floor."""
        self.view = view.enlarged(SUPERSAMPLING)
        self.enlarged_image = background.copy() if background else Image.new("RGB", self.view.size_px, theme.CARD)
        self._draw = ImageDraw.Draw(self.enlarged_image, "RGBA")

    def image(self) -> Image.Image:
        """The picture, anti-aliased."""
        return self.enlarged_image.reduce(SUPERSAMPLING)

    def grid(self, spacing_m: float = 1.0) -> None:
        """Thin lines a metre apart, to judge distances by."""
        reach = math.hypot(*self.view.size_px) / self.view.pixels_per_m / 2
        for axis in (0, 1):
            first = math.ceil((self.view.centre_w[axis] - reach) / spacing_m)
            last = math.floor((self.view.centre_w[axis] + reach) / spacing_m)
            for k in range(first, last + 1):
                ends = np.array([self.view.centre_w, self.view.centre_w], np.float64)
                ends[:, axis] = k * spacing_m
                ends[:, 1 - axis] += (-reach, reach)
                self.line(ends, theme.GRID, 1.0)

    def floor_plan(self, plan: FloorPlan) -> None:
        """Furniture under walls; table tops under the legs that the lidar sees."""
        for outline, fill, edge in _outlines(plan):
            self._draw.polygon(self._flat(outline), fill=fill, outline=edge, width=SUPERSAMPLING)

    def line(
        self, points_w: Float[np.ndarray, "n 2"], colour: theme.Colour, width_px: float, opacity: float = 1.0
    ) -> None:
        """A line through points; `width_px` in pixels of the final picture."""
        if len(points_w) >= 2:
            width = max(1, round(width_px * SUPERSAMPLING))
            self._draw.line(self._flat(points_w), fill=_rgba(colour, opacity), width=width, joint="curve")

    def fading_track(
        self, points_w: Float[np.ndarray, "n 2"], colour: theme.Colour, width_px: float, opacity: float
    ) -> None:
        """A line that is `opacity` strong at its end and vanishes towards its beginning."""
        for k in range(1, len(points_w)):
            self.line(points_w[k - 1 : k + 1], colour, width_px, opacity * k / (len(points_w) - 1))

    def disc(
        self,
        centre_w: Float[np.ndarray, "2"],
        radius_m: float,
        fill: theme.Colour | None,
        edge: theme.Colour | None = None,
        opacity: float = 1.0,
        edge_px: float = 1.0,
    ) -> None:
        """A filled circle, or a ring without `fill`."""
        x, y = self.view.pixels(centre_w)
        r = radius_m * self.view.pixels_per_m
        self._draw.ellipse(
            (x - r, y - r, x + r, y + r),
            fill=_rgba(fill, opacity) if fill else None,
            outline=_rgba(edge, opacity) if edge else None,
            width=round(edge_px * SUPERSAMPLING),
        )

    def person(self, centre_w: Float[np.ndarray, "2"], heading_rad: float | None, radius_m: float) -> None:
        """Shoulders across the way they look, and the head leaning towards it; a disc where that is not known."""
        if heading_rad is None:
            self.disc(centre_w, radius_m, theme.PERSON, theme.PERSON_EDGE)
            self.disc(centre_w, _HEAD_RADIUS_M, theme.PERSON_EDGE)
            return
        depth = half_depth(radius_m)
        ahead = np.array([math.cos(heading_rad), math.sin(heading_rad)])
        # Two half circles, from the back of the right shoulder to its front, then around the left one.
        turn = np.linspace(-math.pi, 0.0, 16)
        arc, shoulder = depth * np.stack([np.cos(turn), np.sin(turn)], axis=-1), np.array([0.0, radius_m - depth])
        outline = np.concatenate([arc - shoulder, shoulder - arc])
        outline = centre_w + outline @ np.array([[ahead[0], ahead[1]], [-ahead[1], ahead[0]]])
        self._draw.polygon(self._flat(outline), fill=theme.PERSON, outline=theme.PERSON_EDGE, width=SUPERSAMPLING)
        self.disc(centre_w + 0.45 * depth * ahead, _HEAD_RADIUS_M, theme.PERSON_EDGE)

    def robot(self, pose_w: Float[np.ndarray, "3"], radius_m: float) -> None:
        """A disc with an arrowhead towards where it looks."""
        centre = np.asarray(pose_w[:2])
        self.disc(centre, radius_m, theme.ROBOT, theme.ROBOT_EDGE)
        corners = pose_w[2] + np.array([0.0, 2.45, math.pi, -2.45])
        reach = radius_m * np.array([0.75, 0.68, 0.22, 0.68])[:, None]
        head = centre + reach * np.stack([np.cos(corners), np.sin(corners)], axis=-1)
        self._draw.polygon(self._flat(head), fill=theme.CARD)

    def goal(self, centre_w: Float[np.ndarray, "2"], radius_m: float = 0.30) -> None:
        """A star in the ring within which the goal counts as reached."""
        self.disc(centre_w, radius_m, theme.GOAL, theme.GOAL, opacity=0.25)
        angles = np.pi / 2 + np.arange(10) * np.pi / 5
        reach = np.where(np.arange(10) % 2 == 0, 0.9, 0.38)[:, None] * radius_m
        # Upright on the picture, however the world is turned.
        star = np.stack([np.cos(angles), -np.sin(angles)], axis=-1) * reach * self.view.pixels_per_m
        points = self.view.pixels(centre_w) + star
        self._draw.polygon(points.ravel().tolist(), fill=theme.GOAL, outline=theme.GOAL_EDGE, width=SUPERSAMPLING)

    def region(self, outline_w: Float[np.ndarray, "n 2"], colour: theme.Colour, opacity: float) -> None:
        """A tinted area."""
        self._draw.polygon(self._flat(outline_w), fill=_rgba(colour, opacity))

    def dots(self, points_w: Float[np.ndarray, "n 2"], colour: theme.Colour, radius_px: float) -> None:
        """Small dots of `radius_px` pixels of the final picture."""
        r = radius_px * SUPERSAMPLING
        for x, y in self.view.pixels(points_w).tolist():
            self._draw.rectangle((x - r, y - r, x + r, y + r), fill=colour)

    def _flat(self, points_w: Float[np.ndarray, "n 2"]) -> list[float]:
        return self.view.pixels(points_w).ravel().tolist()


def _rgba(colour: theme.Colour, opacity: float) -> tuple[int, int, int, int]:
    return (*colour, round(255 * opacity))


def _outlines(plan: FloorPlan) -> list[tuple[Float[np.ndarray, "n 2"], theme.Colour, theme.Colour]]:
    """Outline, fill and edge of everything in a plan, in the order to draw it; of what is overhead, crowns alone."""
    shapes = []
    for (x, y, yaw, half_length, half_width, z_min, z_max), material in zip(
        plan.boxes.tolist(), plan.box_materials, strict=True
    ):
        corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * (half_length, half_width)
        cos, sin = math.cos(yaw), math.sin(yaw)
        shapes.append((corners @ np.array([[cos, sin], [-sin, cos]]) + (x, y), z_min, z_max, material))
    for (x, y, radius, z_min, z_max), material in zip(plan.cylinders.tolist(), plan.cylinder_materials, strict=True):
        angles = np.linspace(0, 2 * np.pi, 40, endpoint=False)
        shapes.append((np.stack([np.cos(angles), np.sin(angles)], axis=-1) * radius + (x, y), z_min, z_max, material))

    drawn = []
    for outline, z_min, z_max, material in shapes:
        if z_min >= WALL_HEIGHT_M and material != "plant":
            continue
        if z_min >= WALL_HEIGHT_M:
            drawn.append((-1, outline, theme.CROWN, theme.PLANT))
            continue
        if material == "glass":
            drawn.append((3, outline, theme.VIEW, theme.VIEW))
        elif material == "plant":
            drawn.append((1, outline, theme.PLANT, theme.PLANT_EDGE))
        elif z_max > WALL_HEIGHT_M:
            drawn.append((3, outline, theme.WALL, theme.WALL))
        elif z_max <= LOW_M:
            drawn.append((0, outline, theme.LOW, theme.LOW_EDGE))
        elif z_min > 0.1:
            drawn.append((1, outline, theme.TABLE_TOP, theme.TABLE_EDGE))
        else:
            drawn.append((2, outline, theme.FURNITURE, theme.FURNITURE_EDGE))
    for place in plan.meshes:
        cos, sin = math.cos(place.yaw), math.sin(place.yaw)
        corners = place.mesh.triangles.astype(np.float64)
        z_min, z_max = corners[..., 2].min(axis=1) + place.z, corners[..., 2].max(axis=1) + place.z
        for triangle in corners[(z_min < WALL_HEIGHT_M) & (z_max > GROUND_M), :, :2]:
            outline = triangle @ np.array([[cos, sin], [-sin, cos]]) + (place.x, place.y)
            drawn.append((2, outline, theme.FURNITURE, theme.FURNITURE))

    drawn.sort(key=lambda entry: entry[0])
    return [(outline, fill, edge) for _, outline, fill, edge in drawn]
