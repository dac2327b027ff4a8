"""ROS messages as plain values, and how they become a `SensorFrame`'s arrays. No ROS is imported: attributes of ROS 1,
ROS 2 and rosbags' messages bear the same names but for the clock's. Whatever is malformed is refused by name.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float, Float32, Int64, UInt16

from densecavoid.frames import CameraConfig, LidarConfig, require

MAX_RAYS = 100_000
MAX_PIXELS = 10_000_000
_DEPTH_TYPES = {"16UC1": np.dtype(np.uint16), "mono16": np.dtype(np.uint16), "32FC1": np.dtype(np.float32)}


@dataclass(frozen=True)
class Scan:
    """A planar scan as the driver sent it."""

    stamp_s: float
    frame: str
    angle_min_rad: float
    increment_rad: float
    range_min_m: float
    range_max_m: float
    ranges_m: Float[np.ndarray, "rays"]

    def __post_init__(self) -> None:
        require(self.ranges_m.ndim == 1, "scan's ranges", self.ranges_m.shape, "one row")
        require(2 <= len(self.ranges_m) <= MAX_RAYS, "scan's number of ranges", len(self.ranges_m), f"2 to {MAX_RAYS}")
        numbers = (self.angle_min_rad, self.increment_rad, self.range_min_m, self.range_max_m)
        require(all(map(math.isfinite, numbers)), "scan's angles and limits", numbers, "finite")
        require(abs(self.angle_min_rad) <= 2 * math.pi + 1e-3, "scan's angle_min", self.angle_min_rad, "an angle")
        turn = abs(self.increment_rad) * (len(self.ranges_m) - 1)
        require(0 < turn <= 2 * math.pi + 1e-3, "scan's field of view", turn, "in (0, 2 pi]")
        require(
            0 <= self.range_min_m < self.range_max_m,
            "scan's range_min and range_max",
            (self.range_min_m, self.range_max_m),
            "0 <= min < max",
        )


@dataclass(frozen=True)
class DepthImage:
    """A depth image as it was sent (REP-118): metres are worked out only of what is looked at."""

    stamp_s: float
    frame: str
    pixels: UInt16[np.ndarray, "height width"] | Float32[np.ndarray, "height width"]
    """Millimetres with 0 for none, or metres."""

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.pixels.shape[0], self.pixels.shape[1]

    @property
    def depth_m(self) -> Float32[np.ndarray, "height width"]:
        """Metres along the optical axis; NaN where there is none."""
        return _metres(self.pixels)

    def at(self, places: Int64[np.ndarray, "*n"]) -> Float32[np.ndarray, "*n"]:
        """The same of some pixels, counted row by row."""
        return _metres(self.pixels.ravel()[places])


def _metres(pixels: np.ndarray) -> np.ndarray:
    depth = pixels.astype(np.float32)
    if pixels.dtype.kind == "u":
        depth *= np.float32(1e-3)
        depth[pixels == 0] = np.nan
    else:
        depth[~(np.isfinite(depth) & (depth > 0))] = np.nan
    return depth


@dataclass(frozen=True)
class Intrinsics:
    """A camera's focal lengths and centre, in pixels of images of its size."""

    width: int
    height: int
    focal_x: float
    focal_y: float
    centre_x: float
    centre_y: float

    def __post_init__(self) -> None:
        require(0 < self.width * self.height <= MAX_PIXELS, "camera_info's size", (self.width, self.height), "a size")
        for name in ("focal_x", "focal_y"):
            value = getattr(self, name)
            require(math.isfinite(value) and value > 1.0, f"camera_info's {name}", value, "more than a pixel")
        centre = (self.centre_x, self.centre_y)
        require(all(map(math.isfinite, centre)), "camera_info's centre", centre, "finite")


@dataclass(frozen=True)
class Odometry:
    """Where the wheels have the robot, and how fast it is."""

    stamp_s: float
    frame: str
    child_frame: str
    pose: tuple[float, float, float]
    """x, y (m), yaw (rad)."""
    velocity: tuple[float, float]
    """Linear (m/s), angular (rad/s)."""


@dataclass(frozen=True)
class Goal:
    """Where to drive, in a frame of its own."""

    stamp_s: float
    frame: str
    pos: tuple[float, float]


# -- from ROS ----------------------------------------------------------------------------------------------------------


def stamp_of(header: Any) -> float:
    """Seconds of a header's stamp: ROS 2 and rosbags have `nanosec`, ROS 1 `nsecs`.

    Raises:
        ValueError: if it is no time.
    """
    stamp = header.stamp
    seconds = stamp.sec if hasattr(stamp, "sec") else stamp.secs
    nanoseconds = stamp.nanosec if hasattr(stamp, "nanosec") else stamp.nsecs
    require(0 <= nanoseconds < 1_000_000_000, "stamp's nanoseconds", nanoseconds, "in [0, 1e9)")
    return seconds + 1e-9 * nanoseconds


def scan_from_ros(message: Any) -> Scan:
    """A sensor_msgs/LaserScan.

    Raises:
        ValueError: naming what is wrong with it.
    """
    return Scan(
        stamp_of(message.header),
        message.header.frame_id,
        float(message.angle_min),
        float(message.angle_increment),
        float(message.range_min),
        float(message.range_max),
        np.asarray(message.ranges, np.float64),
    )


def depth_from_ros(message: Any) -> DepthImage:
    """A sensor_msgs/Image of depth: 16UC1 in millimetres with 0 for none, or 32FC1 in metres (REP-118).

    Raises:
        ValueError: naming what is wrong with it.
    """
    encoding = str(message.encoding)
    require(encoding in _DEPTH_TYPES, "depth image's encoding", encoding, ", ".join(_DEPTH_TYPES))
    width, height, step = int(message.width), int(message.height), int(message.step)
    require(width > 0 and height > 0, "depth image's size", (width, height), "positive")
    require(width * height <= MAX_PIXELS, "depth image's size", (width, height), f"at most {MAX_PIXELS} pixels")
    kind = _DEPTH_TYPES[encoding]
    require(step >= width * kind.itemsize, "depth image's step", step, f"at least {width * kind.itemsize}")
    data = np.frombuffer(message.data, np.uint8)
    # The last row may lack its padding.
    needed = step * (height - 1) + width * kind.itemsize
    require(needed <= len(data) <= step * height, "depth image's bytes", len(data), f"{step} x {height}")
    if len(data) < step * height:
        data = np.concatenate([data, np.zeros(step * height - len(data), np.uint8)])
    rows = data.reshape(height, step)[:, : width * kind.itemsize]
    pixels = np.ascontiguousarray(rows).view(kind)
    if bool(message.is_bigendian) != (sys.byteorder == "big"):
        pixels = pixels.byteswap()
    return DepthImage(stamp_of(message.header), message.header.frame_id, pixels)


def intrinsics_from_ros(message: Any) -> Intrinsics:
    """A sensor_msgs/CameraInfo: the matrix K (`k` in ROS 2).

    Raises:
        ValueError: naming what is wrong with it.
    """
    matrix = [float(value) for value in (message.k if hasattr(message, "k") else message.K)]
    require(len(matrix) == 9, "camera_info's K", len(matrix), "9 numbers")
    return Intrinsics(int(message.width), int(message.height), matrix[0], matrix[4], matrix[2], matrix[5])


def _quaternion(orientation: Any) -> tuple[float, float, float, float]:
    x, y, z, w = (float(getattr(orientation, axis)) for axis in "xyzw")
    norm = x * x + y * y + z * z + w * w
    require(0.98 < norm < 1.02, "quaternion", (x, y, z, w), "of length 1")
    return x, y, z, w


def yaw_of(orientation: Any) -> float:
    """Heading of a quaternion about the vertical.

    Raises:
        ValueError: if it is not of length one.
    """
    x, y, z, w = _quaternion(orientation)
    return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def rotation_of(orientation: Any) -> Float[np.ndarray, "3 3"]:
    """A quaternion as a matrix that turns the child's axes into the parent's.

    Raises:
        ValueError: if it is not of length one.
    """
    x, y, z, w = np.array(_quaternion(orientation)) / np.linalg.norm(_quaternion(orientation))
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def odometry_from_ros(message: Any) -> Odometry:
    """A nav_msgs/Odometry.

    Raises:
        ValueError: naming what is wrong with it.
    """
    place, twist = message.pose.pose.position, message.twist.twist
    values = (float(place.x), float(place.y), float(twist.linear.x), float(twist.angular.z))
    require(all(map(math.isfinite, values)), "odometry", values, "finite")
    require(max(map(abs, values[2:])) < 20.0, "odometry's velocity", values[2:], "a robot's")
    return Odometry(
        stamp_of(message.header),
        message.header.frame_id,
        message.child_frame_id,
        (values[0], values[1], yaw_of(message.pose.pose.orientation)),
        (values[2], values[3]),
    )


def goal_from_ros(message: Any) -> Goal:
    """A geometry_msgs/PoseStamped. Its heading does not matter, so that it may be unset.

    Raises:
        ValueError: if the place is not finite.
    """
    place = message.pose.position
    pos = (float(place.x), float(place.y))
    require(all(map(math.isfinite, pos)), "goal", pos, "finite")
    return Goal(stamp_of(message.header), message.header.frame_id, pos)


# -- to the policy's sensors -------------------------------------------------------------------------------------------


def clean_ranges(
    scan: Scan, zero: Literal["invalid", "nothing"] = "invalid", ignore_within_m: float = 0.0
) -> Float[np.ndarray, "rays"]:
    """Ranges by REP-117: a distance; +inf where nothing is in range; NaN where the scanner does not know.

    -inf (too near to measure) and anything nearer than the least range become the least range, beyond the greatest
    +inf.

    Args:
        scan: as sent.
        zero: what an exact 0 stands for: older drivers send it where nothing is in range.
        ignore_within_m: nearer returns are the robot's own body, and become +inf.
    """
    ranges = scan.ranges_m.astype(np.float64)
    unknown = np.isnan(ranges) | ((ranges < 0) & np.isfinite(ranges))
    zeros = ranges == 0
    ranges = np.where(ranges < max(scan.range_min_m, 1e-3), max(scan.range_min_m, 1e-3), ranges)
    ranges[ranges > scan.range_max_m] = np.inf
    ranges[ranges < ignore_within_m] = np.inf
    ranges[zeros] = np.nan if zero == "invalid" else np.inf
    ranges[unknown] = np.nan
    return ranges


@dataclass(frozen=True)
class Mount:
    """Where a scanner sits on the robot: x ahead, y left (m), its heading, and whether it hangs upside down."""

    x_m: float = 0.0
    y_m: float = 0.0
    yaw_rad: float = 0.0
    upside_down: bool = False

    def __post_init__(self) -> None:
        numbers = (self.x_m, self.y_m, self.yaw_rad)
        require(all(map(math.isfinite, numbers)), "mount", numbers, "finite")
        require(math.hypot(self.x_m, self.y_m) < 5.0, "mount", (self.x_m, self.y_m), "on the robot")


def scan_in_robot(
    scan: Scan, ranges_m: Float[np.ndarray, "rays"], mount: Mount
) -> tuple[Float[np.ndarray, "rays 2"], Float[np.ndarray, "rays"]]:
    """Where each ray ends in the robot's frame (not finite where nothing is in range), and its direction there."""
    angles = scan.angle_min_rad + scan.increment_rad * np.arange(len(ranges_m))
    angles = mount.yaw_rad + (-angles if mount.upside_down else angles)
    with np.errstate(invalid="ignore"):
        ends = np.stack([mount.x_m + ranges_m * np.cos(angles), mount.y_m + ranges_m * np.sin(angles)], axis=1)
    return ends, (angles + np.pi) % (2 * np.pi) - np.pi


def resample_scan(
    scan: Scan, ranges_m: Float[np.ndarray, "rays"], mount: Mount, lidar: LidarConfig
) -> tuple[Float32[np.ndarray, "policy_rays"], Bool[np.ndarray, "policy_rays"]]:
    """A scan of any fov and count as the policy's scanner would see it: the nearest return in each ray's sector.

    Each ray stands for the sector up to its neighbours, so that a coarser scanner leaves no holes.

    Returns:
        ranges (+inf where nothing is in range or nobody looks), and whether a valid ray of the scanner looks there.
    """
    ends, direction = scan_in_robot(scan, ranges_m, mount)
    valid = ~np.isnan(ranges_m)
    hit = np.isfinite(ranges_m)
    offset = ends - np.array([lidar.mount_x_m, 0.0])
    distance = np.where(hit, np.hypot(offset[:, 0], offset[:, 1]), np.inf)
    bearing = np.where(hit, np.arctan2(offset[:, 1], offset[:, 0]), direction)
    count, spacing = lidar.num_rays, lidar.fov_rad / (lidar.num_rays - 1)
    # Half a sector either way; the place of a ray among the policy's, as a number of spacings.
    half = max(abs(scan.increment_rad) / spacing, 1.0) / 2.0
    place = (bearing + lidar.fov_rad / 2) / spacing
    first = np.ceil(place - half - 1e-9).astype(np.int64)
    last = np.floor(place + half + 1e-9).astype(np.int64)
    out, seen = np.full(count, np.inf), np.zeros(count, np.bool_)
    for step in range(math.ceil(2 * half) + 1):
        ray = first + step
        inside = valid & (ray <= last) & (ray >= 0) & (ray < count)
        np.minimum.at(out, ray[inside], distance[inside])
        seen[ray[inside]] = True
    out[out > lidar.max_range_m] = np.inf
    return out.astype(np.float32), seen


def intrinsics_of(image: DepthImage, intrinsics: Intrinsics | None, camera: CameraConfig) -> Intrinsics:
    """Of an image. A camera_info may be for the full image and the image binned: only the shape must agree.

    Args:
        image: as sent.
        intrinsics: of its camera; without, the image is taken to have the policy's field of view.
        camera: the policy's.

    Raises:
        ValueError: if the camera_info's shape is not the image's.
    """
    height, width = image.shape
    if intrinsics is None:
        focal_x = width / 2 / math.tan(camera.fov_horizontal_rad / 2)
        focal_y = height / 2 / math.tan(camera.fov_vertical_rad / 2)
        return Intrinsics(width, height, focal_x, focal_y, width / 2 - 0.5, height / 2 - 0.5)
    require(
        abs(intrinsics.width * height - intrinsics.height * width) <= max(width, height),
        "camera_info's size",
        (intrinsics.width, intrinsics.height),
        f"the shape of the image, {width} x {height}",
    )
    scale = width / intrinsics.width
    centre = (scale * (intrinsics.centre_x + 0.5) - 0.5, scale * (intrinsics.centre_y + 0.5) - 0.5)
    return Intrinsics(width, height, scale * intrinsics.focal_x, scale * intrinsics.focal_y, *centre)


_AROUND = np.array([(dv, du) for dv in (-1, 0, 1) for du in (-1, 0, 1)])
"""Rows and columns to a pixel and to those beside it."""


class DepthResampler:
    """Depth images of any size as the policy's camera would see them from where it sits: the pixel on each of its rays,
    and where that has no depth the nearest of the pixels around it. Keeps the table of pixels of one camera."""

    def __init__(self, camera: CameraConfig) -> None:
        self.camera = camera
        self._seen: Intrinsics | None = None
        self._rows: np.ndarray = np.zeros(0, np.int64)
        self._columns: np.ndarray = np.zeros(0, np.int64)
        self._outside: np.ndarray = np.zeros(0, np.bool_)

    def __call__(self, image: DepthImage, intrinsics: Intrinsics | None) -> Float32[np.ndarray, "rows columns"]:
        """Args and errors are those of `intrinsics_of`."""
        seen = intrinsics_of(image, intrinsics, self.camera)
        if seen != self._seen:
            self._look_up(seen)
        out = image.at(self._rows * seen.width + self._columns)
        holes = np.flatnonzero(np.isnan(out) & ~self._outside)
        if len(holes):
            rows = (self._rows[holes] + _AROUND[:, :1]).clip(0, seen.height - 1)
            columns = (self._columns[holes] + _AROUND[:, 1:]).clip(0, seen.width - 1)
            out[holes] = np.fmin.reduce(image.at(rows * seen.width + columns), axis=0)
        out[self._outside] = np.nan
        return out.reshape(self.camera.height, self.camera.width)

    def _look_up(self, seen: Intrinsics) -> None:
        camera, height, width = self.camera, seen.height, seen.width
        columns = np.floor(seen.centre_x - seen.focal_x * camera.column_slopes + 0.5).astype(np.int64)
        rows = np.floor(seen.centre_y - seen.focal_y * camera.row_slopes + 0.5).astype(np.int64)
        inside = ((rows >= 0) & (rows < height))[:, None] & ((columns >= 0) & (columns < width))[None]
        grid = np.broadcast_arrays(rows.clip(0, height - 1)[:, None], columns.clip(0, width - 1)[None])
        self._rows, self._columns = (places.ravel() for places in grid)
        self._outside = ~inside.ravel()
        self._seen = seen
