"""A ROS map (`map.yaml` and its image) as walls: map_server's cell values, and few boxes for the occupied ones.

Reads what nav2_map_server reads, by the same rules (https://wiki.ros.org/map_server, Value Interpretation; Nav2 up to
its release for Jazzy where the two differ). It knows nothing of people and robots.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml
from jaxtyping import Bool, Float, Int8, UInt8, UInt32
from PIL import Image

from densecavoid.frames import choose, require
from densecavoid.scenarios.rectangles import cover
from densecavoid.sim.floorplan import WALL_HEIGHT_M, FloorPlan

FREE, OCCUPIED, UNKNOWN = 0, 100, -1
"""Cell values of nav_msgs/OccupancyGrid; scale and raw maps have values between free and occupied too."""
MODES = ("trinary", "scale", "raw")
_KEYS = ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh", "mode")
_MOST_PIXELS = 100_000_000


@dataclass(frozen=True)
class MapConfig:
    """What a `map.yaml` says."""

    image: Path
    resolution: float
    """Metres a pixel."""
    origin: tuple[float, float, float]
    """Pose (x, y, yaw) of the lower left corner of the lower left pixel, metres and radians."""
    negate: bool
    occupied_thresh: float
    free_thresh: float
    mode: str = "trinary"

    def __post_init__(self) -> None:
        require(0 < self.resolution < math.inf, "resolution", self.resolution, "metres a pixel, positive")
        require(all(map(math.isfinite, self.origin)), "origin", self.origin, "finite numbers x, y, yaw")
        ordered = 0 <= self.free_thresh < self.occupied_thresh <= 1
        thresholds = (self.free_thresh, self.occupied_thresh)
        require(ordered, "free_thresh and occupied_thresh", thresholds, "0 <= free_thresh < occupied_thresh <= 1")
        choose("mode", self.mode, MODES)


@dataclass(frozen=True)
class RosMap:
    """An occupancy grid at its place in the world."""

    cells: Int8[np.ndarray, "rows cols"]
    """Values as in nav_msgs/OccupancyGrid. Row 0 is the image's lowest: rows go along the map's y, columns along x."""
    resolution_m: float
    origin: tuple[float, float, float]

    @property
    def occupied(self) -> Bool[np.ndarray, "rows cols"]:
        """Walls: cells of value 100, what costmap_2d takes as lethal unless told otherwise."""
        return self.cells == OCCUPIED

    @property
    def free(self) -> Bool[np.ndarray, "rows cols"]:
        """Places to be. Unknown cells, and those of a value between, are no walls, but nobody is put there."""
        return self.cells == FREE

    def to_world(self, points: Float[np.ndarray, "N 2"]) -> Float[np.ndarray, "N 2"]:
        """World places of points (column, row) in cells, from the map's lower left corner."""
        x, y, yaw = self.origin
        cos, sin = math.cos(yaw), math.sin(yaw)
        return points * self.resolution_m @ np.array([[cos, sin], [-sin, cos]]) + (x, y)

    def to_cells(self, points_w: Float[np.ndarray, "N 2"]) -> Float[np.ndarray, "N 2"]:
        """The inverse of `to_world`."""
        x, y, yaw = self.origin
        cos, sin = math.cos(yaw), math.sin(yaw)
        return (points_w - (x, y)) @ np.array([[cos, -sin], [sin, cos]]) / self.resolution_m

    def add_walls(self, plan: FloorPlan, material: str = "plaster") -> None:
        """Adds the occupied cells to a plan as few boxes, turned by the origin's yaw."""
        rectangles = cover(self.occupied)
        centres = self.to_world((rectangles[:, :2] + rectangles[:, 2:]) / 2)
        sizes = (rectangles[:, 2:] - rectangles[:, :2]) * self.resolution_m
        for (x, y), (length, width) in zip(centres.tolist(), sizes.tolist(), strict=True):
            plan.box(x, y, length, width, self.origin[2], 0.0, WALL_HEIGHT_M, material)

    def is_free(self, points_w: Float[np.ndarray, "N 2"]) -> Bool[np.ndarray, "N"]:
        """Whether world points lie in free cells."""
        at = np.floor(self.to_cells(points_w)).astype(np.int64)
        rows, cols = self.cells.shape
        inside = (at >= 0).all(axis=1) & (at[:, 0] < cols) & (at[:, 1] < rows)
        at[~inside] = 0
        return inside & (self.cells[at[:, 1], at[:, 0]] == FREE)


def read_ros_map(path: Path) -> RosMap:
    """Reads a `map.yaml` and its image.

    Raises:
        ValueError: naming the file, the key, its value and what was expected.
        OSError: if a file cannot be read.
    """
    config = read_map_config(path)
    try:
        with Image.open(config.image) as image:
            size = image.size
            require(size[0] * size[1] <= _MOST_PIXELS, "image size", size, f"at most {_MOST_PIXELS:,} pixels")
            cells = interpret(image, config)
    except FileNotFoundError:
        raise ValueError(f"{path}: image is {str(config.image)!r}, which does not exist") from None
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise ValueError(f"{path}: image {str(config.image)!r} cannot be read: {error}") from error
    return RosMap(np.ascontiguousarray(cells[::-1]), config.resolution, config.origin)


def read_map_config(path: Path) -> MapConfig:
    """Reads a `map.yaml` alone.

    Raises:
        ValueError: naming the file, the key, its value and what was expected.
        OSError: if the file cannot be read.
    """
    try:
        text = path.read_text("utf-8")
        document = yaml.safe_load(text)
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: is no YAML: {error}") from error
    if not isinstance(document, dict):
        raise ValueError(f"{path}: is {document!r}, expected keys {', '.join(_KEYS)}")
    missing = [key for key in _KEYS[:-1] if key not in document]
    if missing:
        raise ValueError(f"{path}: {missing[0]} is missing, expected {', '.join(_KEYS[:-1])} and perhaps mode")

    def number(key: str) -> float:
        return _number(f"{path}: {key}", document[key])

    image, origin, negate = document["image"], document["origin"], document["negate"]
    require(isinstance(image, str) and image != "", f"{path}: image", image, "the name of an image file")
    is_pose = isinstance(origin, list) and len(origin) == 3
    require(is_pose, f"{path}: origin", origin, "[x, y, yaw] in metres and radians")
    require(isinstance(negate, int), f"{path}: negate", negate, "0 or 1, or true or false")  # a bool is an int
    mode = document.get("mode", "trinary")
    require(isinstance(mode, str), f"{path}: mode", mode, f"one of: {', '.join(MODES)}")
    pose = [_number(f"{path}: origin", value) for value in origin]
    try:
        return MapConfig(
            image=path.parent / image,
            resolution=number("resolution"),
            origin=(pose[0], pose[1], pose[2]),
            negate=bool(negate),
            occupied_thresh=number("occupied_thresh"),
            free_thresh=number("free_thresh"),
            mode=mode,
        )
    except ValueError as error:
        raise error if str(error).startswith(str(path)) else ValueError(f"{path}: {error}") from error


def interpret(image: Image.Image, config: MapConfig) -> Int8[np.ndarray, "rows cols"]:
    """Cell values of an image's pixels, in the image's order of rows.

    With shade s in [0, 1], the mean of the colour channels (in trinary mode of the alpha channel too, where there is
    one), and occupancy p = 1 - s, or s with `negate`:

    - trinary: 100 where p > occupied_thresh, 0 where p < free_thresh, else unknown.
    - scale: unknown where the pixel is not opaque, 100 and 0 as before, else 100 (p - free) / (occupied - free).
    - raw: the shade as a byte where that is at most 100, else unknown. Thresholds and `negate` have no say.
    """
    total, channels, most, alpha = _channels(image, with_alpha=config.mode == "trinary")
    # Few sums can occur: their values are looked up.
    sums = np.arange(channels * most + 1)
    shade = sums / sums[-1]
    occupancy = shade if config.negate else (sums[-1] - sums) / sums[-1]
    if config.mode == "raw":
        byte = np.floor(shade * 255 + 0.5)
        table = np.where(byte <= OCCUPIED, byte, UNKNOWN)
    else:
        between = np.full(len(shade), float(UNKNOWN))
        if config.mode == "scale":
            span = config.occupied_thresh - config.free_thresh
            between = np.rint(np.clip((occupancy - config.free_thresh) / span, 0.0, 1.0) * 100.0)
        table = np.select([occupancy > config.occupied_thresh, occupancy < config.free_thresh], [100.0, 0.0], between)
    cells = table.astype(np.int8)[total]
    if config.mode == "scale" and alpha is not None:
        cells[alpha < most] = UNKNOWN
    return cells


def _channels(
    image: Image.Image, with_alpha: bool
) -> tuple[UInt32[np.ndarray, "rows cols"], int, int, UInt8[np.ndarray, "rows cols"] | None]:
    """Sum of the channels, how many they are, the greatest value of one, and the alpha channel where there is one."""
    if image.mode.startswith("I"):  # 16 bits of grey
        return np.asarray(image).astype(np.uint32), 1, 65535, None
    has_alpha = image.mode in ("LA", "RGBA", "PA") or "transparency" in image.info
    if image.mode in ("1", "L") and not has_alpha:
        return np.asarray(image.convert("L")).astype(np.uint32), 1, 255, None
    pixels = np.asarray(image.convert("RGBA" if has_alpha else "RGB"))
    alpha = pixels[..., 3] if has_alpha else None
    count = 4 if has_alpha and with_alpha else 3
    return pixels[..., :count].sum(axis=-1, dtype=np.uint32), count, 255, alpha


def _number(name: str, value: object) -> float:
    """A YAML number; YAML 1.1 reads `1e-2`, without a point, as a word."""
    try:
        if isinstance(value, (int, float, str)) and not isinstance(value, bool):
            return float(value)
    except ValueError:
        pass
    raise ValueError(f"{name} is {value!r}, expected a number")
