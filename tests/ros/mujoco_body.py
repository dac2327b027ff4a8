"""A MuJoCo world with the fault world's face: the wall's clock, messages, and the base's own watchdog."""

from __future__ import annotations

from typing import Any

import numpy as np

from densecavoid.robot.drivers import Drivers
from densecavoid.robot.fault_world import BASE_TIMEOUT_S, FaultWorld
from densecavoid.robot.mujoco_world import MujocoWorld
from densecavoid.scenarios import make_scenario
from densecavoid.sim.config import SimConfig


class MujocoBody(FaultWorld):
    """People come against the robot, and MuJoCo says what it sees and whether it hits them."""

    def __init__(self, scenario: str, seed: int) -> None:
        super().__init__(np.random.default_rng(seed))
        self.world = MujocoWorld(make_scenario(scenario), seed, SimConfig(threads=1))
        self._drivers = Drivers(self.world.config.lidar, self.world.config.camera)
        self._frame = self.world.sense()
        self._behind_s = 0.0
        self.pose = self.world.robot_pose

    @property
    def outcome(self) -> str:
        """How the episode ended; empty while it goes on."""
        return self.world.outcome

    def drive(self, command: tuple[float, float] | None, dt: float) -> None:
        """So many physics steps as the time makes; what is left of it counts next time."""
        self.now_s += dt
        self._behind_s += dt
        if command is not None:
            self._command, self._commanded_s = command, self.now_s
        while self._behind_s >= self.world.config.physics_dt_s:
            self._behind_s -= self.world.config.physics_dt_s
            fresh = self.now_s - self._commanded_s < BASE_TIMEOUT_S
            self.world.advance(*(self._command if fresh else (0.0, 0.0)))
        self.pose, self.velocity = self.world.robot_pose, self.world.velocity
        self._frame = self.world.sense()

    def scan(self) -> Any:
        return self._drivers.scan(self._frame, self.ros_now_s)

    def depth(self) -> Any:
        return self._drivers.depth(self._frame, self.ros_now_s)

    def camera_info(self) -> Any:
        return self._drivers.camera_info(self.ros_now_s)

    def odom(self) -> Any:
        return self._drivers.odom(self._frame, self.ros_now_s)

    def goal(self) -> Any:
        return self._drivers.goal(self._frame, self.ros_now_s)
