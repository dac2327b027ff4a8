"""A corridor, a base and its sensors, for the fault campaign: messages like ROS's, a Kobuki's limits.
Not the project's simulator: it only has to be fast, and to need nothing from the code that it tries.
"""

from __future__ import annotations

import math
from types import SimpleNamespace as Message
from typing import Any

import numpy as np

RAYS = 360
ANGLES = np.linspace(-2.0, 2.0, RAYS)
CAMERA_HEIGHT_M, DEPTH_LIMITS_M = 0.4, (1.4, 5.0)
LEFT = (19.5 - np.arange(40)) / 20 * math.tan(0.5 * 1.047)
UP = (14.5 - np.arange(30)) / 15 * math.tan(0.5 * 0.864)
"""Slopes of the rays through the image's columns and rows."""
BASE_TIMEOUT_S = 0.6
LENGTH_M, HALF_WIDTH_M = 12.0, 1.5


def _header(stamp_s: float, frame: str) -> Message:
    seconds = math.floor(stamp_s)
    nanoseconds = min(int((stamp_s - seconds) * 1e9), 999_999_999)
    return Message(stamp=Message(sec=seconds, nanosec=nanoseconds), frame_id=frame)


class FaultWorld:
    """Owns the time, the robot's pose and the base's watchdog."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        self.now_s = 10.0
        self.clock_offset_s = 1000.0
        """Of the stamps' clock against the steady one."""
        self.pose = np.zeros(3)
        self.velocity = (0.0, 0.0)
        self._command = (0.0, 0.0)
        self._commanded_s = -math.inf

    @property
    def ros_now_s(self) -> float:
        """The clock that stamps are made with."""
        return self.now_s + self.clock_offset_s

    def drive(self, command: tuple[float, float] | None, dt: float) -> None:
        """One step; None: no command arrives, and the base stops by itself after .6 s."""
        if command is not None:
            self._command, self._commanded_s = command, self.now_s
        target = self._command if self.now_s - self._commanded_s < BASE_TIMEOUT_S else (0.0, 0.0)
        linear = self.velocity[0] + min(max(target[0] - self.velocity[0], -dt), dt)
        angular = self.velocity[1] + min(max(target[1] - self.velocity[1], -3.5 * dt), 3.5 * dt)
        self.velocity = (linear, angular)
        x, y, yaw = self.pose
        self.pose = np.array([x + linear * dt * math.cos(yaw), y + linear * dt * math.sin(yaw), yaw + angular * dt])
        if self.pose[0] > LENGTH_M - 4.0:  # an endless corridor: the robot is set back
            self.pose = np.zeros(3)
        self.now_s += dt

    def scan(self) -> Any:
        """Ranges to the corridor's walls and end."""
        x, y, yaw = self.pose
        cos, sin = np.cos(ANGLES + yaw), np.sin(ANGLES + yaw)
        with np.errstate(divide="ignore"):
            sides = np.where(sin > 0, (HALF_WIDTH_M - y) / sin, (-HALF_WIDTH_M - y) / sin)
            ends = np.where(cos > 0, (LENGTH_M - x) / cos, (-2.0 - x) / cos)
        ranges = np.minimum(sides, ends) + 0.01 * self.rng.standard_normal(RAYS)
        ranges[ranges > 5.5] = np.inf
        return Message(
            header=_header(self.ros_now_s, "laser"),
            angle_min=-2.0,
            angle_increment=4.0 / (RAYS - 1),
            range_min=0.05,
            range_max=5.6,
            ranges=ranges.astype(np.float32),
        )

    def depth(self) -> Any:
        """An image of 40 x 30 in millimetres: walls and floor, as far as the camera sees."""
        x, y, yaw = self.pose
        # Of the ray through each column, and along the optical axis: how fast it comes nearer to side and end.
        across, along = np.sin(yaw) + LEFT * np.cos(yaw), np.cos(yaw) - LEFT * np.sin(yaw)
        with np.errstate(divide="ignore"):
            sides = np.where(across > 0, (HALF_WIDTH_M - y) / across, (-HALF_WIDTH_M - y) / across)
            ends = np.where(along > 0, (LENGTH_M - x) / along, (-2.0 - x) / along)
            floor = np.where(UP < 0, CAMERA_HEIGHT_M / -UP, np.inf)
        depth = np.minimum(np.minimum(sides, ends), floor[:, None])
        depth[(depth < DEPTH_LIMITS_M[0]) | (depth > DEPTH_LIMITS_M[1])] = 0.0
        image = (1000.0 * depth).astype("<u2")
        return Message(
            header=_header(self.ros_now_s, "camera"),
            encoding="16UC1",
            width=40,
            height=30,
            step=80,
            is_bigendian=0,
            data=image.tobytes(),
        )

    def odom(self) -> Any:
        """Exact odometry."""
        x, y, yaw = (float(value) for value in self.pose)
        turn = Message(x=0.0, y=0.0, z=math.sin(yaw / 2), w=math.cos(yaw / 2))
        pose = Message(position=Message(x=x, y=y, z=0.0), orientation=turn)
        twist = Message(linear=Message(x=self.velocity[0]), angular=Message(z=self.velocity[1]))
        return Message(
            header=_header(self.ros_now_s, "odom"),
            child_frame_id="base_footprint",
            pose=Message(pose=pose),
            twist=Message(twist=twist),
        )

    def goal(self) -> Any:
        """Far ahead, in the frame of a map."""
        return Message(header=_header(self.ros_now_s, "map"), pose=Message(position=Message(x=1000.0, y=0.0, z=0.0)))

    def transforms(self, parent: str, child: str) -> list[Any]:
        """One transform that changes nothing."""
        none = Message(x=0.0, y=0.0, z=0.0)
        turn = Message(x=0.0, y=0.0, z=0.0, w=1.0)
        transform = Message(translation=none, rotation=turn)
        return [Message(header=_header(self.ros_now_s, parent), child_frame_id=child, transform=transform)]
