"""The nodes' loop as a navigator: a simulated body's frames go in as messages, what its wheels would be told comes out.
So what drives a robot, watchdog and filter included, drives in the benchmark's worlds too, and in less time.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool

from densecavoid.frames import CameraConfig, Command, LidarConfig, SensorFrame, require
from densecavoid.robot.camera_mount import CameraMount
from densecavoid.robot.config import RobotSettings
from densecavoid.robot.drivers import Drivers
from densecavoid.robot.folder import FolderPilot
from densecavoid.robot.messages import Mount
from densecavoid.robot.runtime import RobotRuntime

_STEADY_S, _ROS_S = 10.0, 1000.0
"""Where the two clocks are when an episode begins; ROS's must not begin at nought, which stands for "no time"."""


class NodeLoop:
    """A navigator of one world, to be asked `settings.control_hz` times a second; scans and images are sent to it at
    the policy's rate, odometry each time."""

    privileged = False

    def __init__(self, folder: Path, settings: RobotSettings, lidar: LidarConfig, camera: CameraConfig) -> None:
        """
        Args:
            folder: exported (`densecavoid export`).
            settings: of the robot. What a simulated body has not (TF, its sensors' places in it) is replaced.
            lidar: of the body.
            camera: of the body.

        Raises:
            ValueError, OSError: naming what is wrong with the folder or the settings.
        """
        ratio = settings.control_hz / settings.policy_hz
        require(abs(ratio - round(ratio)) < 1e-9, "control_hz / policy_hz", ratio, "a whole number")
        mount = Mount(x_m=lidar.mount_x_m)
        place = CameraMount.of(camera)
        self._settings = replace(settings, use_tf=False, lidar_mount=mount, camera_mount=place)
        self._every = round(ratio)
        self._drivers = Drivers(lidar, camera)
        self._pilot = FolderPilot(folder, settings.robot)
        self.name = f"node:{self._pilot.name}"
        self.reset(np.ones(1, np.bool_))

    @property
    def control_dt_s(self) -> float:
        """Between two calls of `act`."""
        return 1.0 / self._settings.control_hz

    def reset(self, which: Bool[np.ndarray, "B"]) -> None:
        """As if the node were started again."""
        require(len(which) == 1, "worlds", len(which), "one")
        if not which[0]:
            return
        self._pilot.reset()
        self._runtime = RobotRuntime(self._pilot, self._settings, threaded=False)
        self._ticks = 0
        self.reasons: dict[str, int] = {}
        """What the loop said, and in how many control steps."""

    def act(self, frame: SensorFrame) -> Command:
        """What the node would publish on `cmd_vel` now; zero where it would say nothing."""
        require(frame.num_worlds == 1, "worlds", frame.num_worlds, "one")
        runtime, drivers, time_s = self._runtime, self._drivers, float(frame.time_s[0])
        now_s, ros_now_s = _STEADY_S + time_s, _ROS_S + time_s
        runtime.on_odom(drivers.odom(frame, ros_now_s), now_s, ros_now_s)
        if self._ticks == 0:
            runtime.on_camera_info(drivers.camera_info(ros_now_s))
            runtime.on_goal(drivers.goal(frame, ros_now_s), now_s)
        if self._ticks % self._every == 0:
            runtime.on_scan(drivers.scan(frame, ros_now_s), now_s, ros_now_s)
            runtime.on_depth(drivers.depth(frame, ros_now_s), now_s, ros_now_s)
        self._ticks += 1
        step = runtime.step(now_s, ros_now_s)
        self.reasons[step.message] = self.reasons.get(step.message, 0) + 1
        command = step.command
        sent = (command.linear_velocity, command.angular_velocity) if command.publish else (0.0, 0.0)
        return Command(np.array(sent[:1], np.float32), np.array(sent[1:], np.float32))
