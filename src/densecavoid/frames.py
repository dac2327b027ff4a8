"""The contracts between rooms: what a body senses, what the policy observes, what it commands, and who navigates.

Frames of reference follow REP-103 (x forward, y left, z up, radians counter-clockwise): `_w` is the world, `_odom` the
robot's odometry frame, `_r` the robot. All arrays are batched, [B, ...], with B = 1 on a real robot.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Float32, Int32, UInt8

MAX_RAYS, MAX_PIXELS = 65_536, 1 << 24
"""Far beyond any sensor: what asks for more is a broken file, and would only take memory."""


def _require_mount_and_clock(name: str, config: LidarConfig | CameraConfig) -> None:
    require(math.isfinite(config.mount_x_m), f"{name}.mount_x_m", config.mount_x_m, "finite")
    for field_name in ("rate_hz", "latency_s"):
        value = getattr(config, field_name)
        require(value >= 0 and math.isfinite(value), f"{name}.{field_name}", value, "0 or more")


@dataclass(frozen=True)
class LidarConfig:
    """A planar scanner. The default is the paper's Hokuyo: 240 degrees, 512 ranges, 4 m (paper, Implementation)."""

    num_rays: int = 512
    fov_rad: float = math.radians(240.0)
    max_range_m: float = 4.0
    min_range_m: float = 0.02
    """Nearer surfaces give no range; exact (`clean`) sensors have no such limit."""
    mount_height_m: float = 0.26
    mount_x_m: float = 0.0
    """Ahead of the robot's centre."""
    mount_pitch_rad: float = 0.0
    """Turned about the robot's y axis: positive looks down ahead (REP-103)."""
    sweep_s: float = 0.0667
    """Time in which real scanners measure their rays, one after another (Hokuyo: 240 of 360 degrees in 100 ms); exact
    ones measure all at once."""
    rate_hz: float = 0.0
    """Scans a second; 0 (or faster than the control) is a scan each control step."""
    latency_s: float = 0.0
    """Age of a scan when it is given out; a whole number of control steps."""

    def __post_init__(self) -> None:
        _require_mount_and_clock("LidarConfig", self)
        require(2 <= self.num_rays <= MAX_RAYS, "LidarConfig.num_rays", self.num_rays, f"2 to {MAX_RAYS}")
        require(0 < self.fov_rad <= 2 * math.pi, "LidarConfig.fov_rad", self.fov_rad, "in (0, 2 pi]")
        require(
            0 <= self.min_range_m < self.max_range_m,
            "LidarConfig ranges",
            (self.min_range_m, self.max_range_m),
            "0 <= min_range_m < max_range_m",
        )
        require(self.mount_height_m > 0, "LidarConfig.mount_height_m", self.mount_height_m, "positive")
        require(
            abs(self.mount_pitch_rad) <= math.radians(80),
            "LidarConfig.mount_pitch_rad",
            self.mount_pitch_rad,
            "at most 80 degrees either way",
        )
        require(0 <= self.sweep_s <= 1, "LidarConfig.sweep_s", self.sweep_s, "in [0, 1] s")

    @property
    def angles_rad(self) -> Float[np.ndarray, "rays"]:
        """Angle of each ray in the scanner's plane, counter-clockwise from -fov/2: of a level one, its bearing."""
        return np.linspace(-self.fov_rad / 2, self.fov_rad / 2, self.num_rays)


@dataclass(frozen=True)
class CameraConfig:
    """A forward-looking depth camera. The default is the paper's Orbbec Astra at the policy's resolution."""

    width: int = 80
    height: int = 60
    fov_horizontal_rad: float = math.radians(60.0)
    fov_vertical_rad: float = math.radians(49.5)
    min_range_m: float = 1.4
    max_range_m: float = 5.0
    mount_height_m: float = 0.40
    mount_x_m: float = 0.0
    """Ahead of the robot's centre."""
    mount_pitch_rad: float = 0.0
    """Turned about the robot's y axis: positive looks down (REP-103)."""
    rate_hz: float = 0.0
    """Images a second; 0 (or faster than the control) is an image each control step."""
    latency_s: float = 0.0
    """Age of an image when it is given out; a whole number of control steps."""

    def __post_init__(self) -> None:
        _require_mount_and_clock("CameraConfig", self)
        require(
            abs(self.mount_pitch_rad) + self.fov_vertical_rad / 2 < math.radians(89),
            "CameraConfig.mount_pitch_rad",
            self.mount_pitch_rad,
            "small enough that no pixel looks straight up or down",
        )
        size = self.width, self.height
        within = min(size) >= 2 and self.width * self.height <= MAX_PIXELS
        require(within, "CameraConfig size", size, f"at least 2 x 2, at most {MAX_PIXELS} pixels")
        for name in ("fov_horizontal_rad", "fov_vertical_rad"):
            require(0 < getattr(self, name) < math.pi, f"CameraConfig.{name}", getattr(self, name), "in (0, pi)")
        require(
            0 <= self.min_range_m < self.max_range_m,
            "CameraConfig ranges",
            (self.min_range_m, self.max_range_m),
            "0 <= min_range_m < max_range_m",
        )

    @property
    def focal_px(self) -> tuple[float, float]:
        """Focal lengths (horizontal, vertical) in pixels."""
        return (
            self.width / 2 / math.tan(self.fov_horizontal_rad / 2),
            self.height / 2 / math.tan(self.fov_vertical_rad / 2),
        )

    @property
    def column_slopes(self) -> Float[np.ndarray, "width"]:
        """Of the ray through the centre of each column: left per forward, of the camera (column 0 is the leftmost)."""
        return (self.width / 2 - (np.arange(self.width) + 0.5)) / self.focal_px[0]

    @property
    def row_slopes(self) -> Float[np.ndarray, "height"]:
        """Of the ray through the centre of each row: up per forward, of the camera (row 0 is the topmost)."""
        return (self.height / 2 - (np.arange(self.height) + 0.5)) / self.focal_px[1]


@dataclass(frozen=True)
class RobotConfig:
    """A differential-drive robot. The default is the paper's Turtlebot 2 with its speed limits."""

    radius_m: float = 0.18
    height_m: float = 0.80
    """Surfaces that begin above this height pass overhead; everything lower can be hit (table tops are)."""
    max_linear_velocity: float = 1.0
    """m/s; the least is 0, the robot does not reverse (paper, Network Architecture)."""
    max_angular_velocity: float = 0.4
    """rad/s, either way (paper, Network Architecture)."""
    max_linear_acceleration: float = 1.0
    """m/s2, used with `dynamic` (Kobuki)."""
    max_angular_acceleration: float = 3.5
    """rad/s2, used with `dynamic` (Kobuki)."""

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            value = getattr(self, name)
            require(value > 0 and math.isfinite(value), f"RobotConfig.{name}", value, "positive and finite")


NUM_SCANS = 3
"""Consecutive scans in an observation (paper, Fig. 3)."""
PERSON_NUMBERS = 6
"""What training may be told of each true person: x, y (m) and velocity x, y (m/s) in the robot's frame, radius (m), and
1 if there is one."""


class People(NamedTuple):
    """Ground truth about everybody in each world. Slots that are not `active` hold no meaning."""

    pos_w: Float32[np.ndarray, "B P 2"]
    vel_w: Float32[np.ndarray, "B P 2"]
    radius_m: Float32[np.ndarray, "B P"]
    height_m: Float32[np.ndarray, "B P"]
    active: Bool[np.ndarray, "B P"]
    id: Int32[np.ndarray, "B P"]
    """Stays with a person for as long as the episode lasts, whatever slot they are in."""


class Truth(NamedTuple):
    """What only a simulator knows. A navigator that reads it is `privileged` and says so in every table."""

    robot_pose_w: Float[np.ndarray, "B 3"]
    people: People


@dataclass(frozen=True)
class SensorFrame:
    """All that a body senses at one instant. The body may reuse the arrays: copy what must outlast the next frame."""

    time_s: Float[np.ndarray, "B"]
    scan_m: Float32[np.ndarray, "B rays"]
    """Ranges in the order of `LidarConfig.angles_rad`; +inf where nothing is in range (REP-117)."""
    depth_m: Float32[np.ndarray, "B height width"]
    """Distance along the optical axis; NaN where there is none. Row 0 is the top, column 0 the left."""
    odom_pose: Float[np.ndarray, "B 3"]
    """x, y, yaw of the robot in the odometry frame, which is the world's at the start of an episode and then drifts."""
    velocity: Float32[np.ndarray, "B 2"]
    """Measured linear (m/s) and angular (rad/s) velocity."""
    goal_odom: Float[np.ndarray, "B 2"]
    truth: Truth | None = None

    @property
    def num_worlds(self) -> int:
        return self.scan_m.shape[0]


COMMAND_GRID = np.array([(v, w) for v in (0.0, 0.25, 0.5, 0.75, 1.0) for w in (-1.0, -0.5, 0.0, 0.5, 1.0)])
"""Commands that are weighed against each other: linear and angular velocity as shares of the robot's greatest."""


class Observation(NamedTuple):
    """The policy's input, o = [lidar, camera, goal, velocity, prediction] (paper, Section III-A)."""

    lidar: Float32[np.ndarray, "B scans rays"]
    """Three consecutive scans, oldest first, as fractions of the greatest range (1 where nothing is in range). Instead
    of the oldest a policy may be shown what is remembered of the camera's past (`perception.memory`), and besides
    scans of where people are expected (`perception.foretold_scans`)."""
    camera: UInt8[np.ndarray, "B height width"]
    """Nearness of the depth image: 255 at the camera's least range, 1 at its greatest, 0 where there is no depth."""
    goal: Float32[np.ndarray, "B 2"]
    """Distance (m) and bearing (rad, left positive) of the goal in the robot frame."""
    velocity: Float32[np.ndarray, "B 2"]
    """Linear (m/s) and angular (rad/s) velocity."""
    prediction: UInt8[np.ndarray, "B height width"]
    """The prediction frame: 0 (black) where a person is expected, 255 (white) elsewhere."""
    worth: Float32[np.ndarray, "B commands"]
    """What each of `COMMAND_GRID` would be worth in the world as perceived (`perception.outlook`; reaching the goal at
    once is 1, a collision at once -.5), where the policy is told; 0 elsewhere."""


class Command(NamedTuple):
    """What the wheels should do until the next command."""

    linear_velocity: Float32[np.ndarray, "B"]
    angular_velocity: Float32[np.ndarray, "B"]


@runtime_checkable
class Navigator(Protocol):
    """Everything between sensors and wheels. Batched; keeps whatever memory it needs for each world."""

    @property
    def name(self) -> str:
        """As it appears in tables."""
        ...

    @property
    def privileged(self) -> bool:
        """Whether it reads `SensorFrame.truth`."""
        ...

    def reset(self, which: Bool[np.ndarray, "B"]) -> None:
        """Forget the episodes of the worlds marked in `which`; its length sets the batch size."""
        ...

    def act(self, frame: SensorFrame) -> Command:
        """The command for each world of the frame."""
        ...


def require(condition: bool | np.bool_, name: str, value: object, expected: str) -> None:
    """Raises ValueError naming the argument, its value and what was expected, unless the condition holds."""
    if not condition:
        raise ValueError(f"{name} is {value!r}, expected {expected}")


def wrap_angle(angle_rad: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """The same angle in [-pi, pi)."""
    return (angle_rad + np.pi) % (2 * np.pi) - np.pi


def goal_polar(
    pose: Float[np.ndarray, "B 3"], goal: Float[np.ndarray, "B 2"]
) -> tuple[Float[np.ndarray, "B"], Float[np.ndarray, "B"]]:
    """Distance (m) and bearing (rad) of a goal seen from poses in the same frame."""
    offset = goal - pose[:, :2]
    return np.hypot(offset[:, 0], offset[:, 1]), wrap_angle(np.arctan2(offset[:, 1], offset[:, 0]) - pose[:, 2])


def into_robot_frame(
    yaw_rad: Float[np.ndarray, "*robots"], vectors: Float[np.ndarray, "*robots vectors 2"]
) -> Float[np.ndarray, "*robots vectors 2"]:
    """Vectors along the axes of robots with these headings (x ahead, y left)."""
    cos, sin = np.cos(yaw_rad)[..., None], np.sin(yaw_rad)[..., None]
    x, y = vectors[..., 0], vectors[..., 1]
    return np.stack([cos * x + sin * y, cos * y - sin * x], axis=-1)


def seen_from(
    pose: Float[np.ndarray, "*robots 3"], points: Float[np.ndarray, "*robots points 2"]
) -> Float[np.ndarray, "*robots points 2"]:
    """Points in the frame of robots at these poses (x, y, yaw; same frame as the points)."""
    return into_robot_frame(pose[..., 2], points - pose[..., None, :2])


def choose(name: str, value: str, known: Sequence[str]) -> str:
    """`value`, if it is one of `known`.

    Raises:
        ValueError: naming what was asked for and what there is.
    """
    if value not in known:
        raise ValueError(f"unknown {name} {value!r}, expected one of: {', '.join(known)}")
    return value
