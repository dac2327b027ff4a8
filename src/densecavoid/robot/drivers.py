"""What a robot's drivers would send of a simulated body's `SensorFrame`: ROS messages as plain values. Knows no ROS.
The way back, from messages to frames, is messages.py.
"""

from __future__ import annotations

import math
from types import SimpleNamespace as Message
from typing import Any

import numpy as np

from densecavoid.frames import CameraConfig, LidarConfig, SensorFrame


class Drivers:
    """The drivers of one robot: world 0 of each frame they are given."""

    def __init__(self, lidar: LidarConfig, camera: CameraConfig) -> None:
        """
        Args:
            lidar: that the frames' scans come from; its mount must be level, as a LaserScan is taken for.
            camera: that their depth images come from.
        """
        self._lidar, self._camera = lidar, camera

    def scan(self, frame: SensorFrame, stamp_s: float) -> Any:
        """A sensor_msgs/LaserScan; +inf where nothing is in range (REP-117)."""
        lidar = self._lidar
        return Message(
            header=header(stamp_s, "laser"),
            angle_min=-lidar.fov_rad / 2,
            angle_max=lidar.fov_rad / 2,
            angle_increment=lidar.fov_rad / (lidar.num_rays - 1),
            range_min=lidar.min_range_m,
            range_max=lidar.max_range_m,
            ranges=frame.scan_m[0].copy(),
        )

    def depth(self, frame: SensorFrame, stamp_s: float) -> Any:
        """A sensor_msgs/Image, 16UC1: millimetres, 0 where there is no depth (REP-118)."""
        height, width = frame.depth_m.shape[1:]
        millimetres = np.nan_to_num(1000.0 * frame.depth_m[0], nan=0.0).round().astype("<u2")
        return Message(
            header=header(stamp_s, "camera"),
            encoding="16UC1",
            width=width,
            height=height,
            step=2 * width,
            is_bigendian=0,
            data=millimetres.tobytes(),
        )

    def camera_info(self, stamp_s: float) -> Any:
        """A sensor_msgs/CameraInfo, whose matrix ROS 1 calls K."""
        camera = self._camera
        focal_x, focal_y = camera.focal_px
        centre_x, centre_y = camera.width / 2 - 0.5, camera.height / 2 - 0.5
        matrix = [focal_x, 0.0, centre_x, 0.0, focal_y, centre_y, 0.0, 0.0, 1.0]
        return Message(header=header(stamp_s, "camera"), width=camera.width, height=camera.height, k=matrix)

    def odom(self, frame: SensorFrame, stamp_s: float) -> Any:
        """A nav_msgs/Odometry."""
        x, y, yaw = (float(value) for value in frame.odom_pose[0])
        linear, angular = (float(value) for value in frame.velocity[0])
        turn = Message(x=0.0, y=0.0, z=math.sin(yaw / 2), w=math.cos(yaw / 2))
        pose = Message(position=Message(x=x, y=y, z=0.0), orientation=turn)
        return Message(
            header=header(stamp_s, "odom"),
            child_frame_id="base_footprint",
            pose=Message(pose=pose),
            twist=Message(twist=Message(linear=Message(x=linear), angular=Message(z=angular))),
        )

    def goal(self, frame: SensorFrame, stamp_s: float) -> Any:
        """A geometry_msgs/PoseStamped in the odometry frame."""
        x, y = (float(value) for value in frame.goal_odom[0])
        return Message(header=header(stamp_s, "odom"), pose=Message(position=Message(x=x, y=y, z=0.0)))


def header(stamp_s: float, frame: str) -> Any:
    """A std_msgs/Header."""
    seconds = math.floor(stamp_s)
    nanoseconds = min(int((stamp_s - seconds) * 1e9), 999_999_999)
    return Message(stamp=Message(sec=seconds, nanosec=nanoseconds), frame_id=frame)
