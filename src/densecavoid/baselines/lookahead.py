"""Drives the command that is worth most in the next seconds, in the world as the robot perceives it (`outlook`).

No learning, and no knowledge but the sensors': what tracking and planning alone are worth, beside a policy.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from jaxtyping import Bool

from densecavoid.baselines.surroundings import PeopleAround, WayAround
from densecavoid.frames import CameraConfig, Command, LidarConfig, RobotConfig, SensorFrame, require
from densecavoid.perception.outlook import Outlook, OutlookConfig


class Lookahead:
    """Satisfies `frames.Navigator`."""

    def __init__(
        self,
        robot: RobotConfig = RobotConfig(),
        lidar: LidarConfig = LidarConfig(),
        camera: CameraConfig = CameraConfig(),
        config: OutlookConfig | None = None,
        source: Literal["tracks", "truth"] = "tracks",
        threads: int = 0,
    ) -> None:
        """
        Args:
            robot: whose limits and height count.
            lidar, camera: whose frames it will be given.
            config: what is good.
            source: of people: tracked ones, or all there are.
            threads: over the worlds; 0 takes all cores.
        """
        self.robot = robot
        self.name = "lookahead" if source == "tracks" else "lookahead-privileged"
        self._people = PeopleAround(source, lidar, camera, standing=True)
        self._way = WayAround(robot, lidar, camera, every_s=0.0, threads=threads)
        self._outlook = Outlook(config or OutlookConfig(), robot, threads)
        self._worth = np.zeros((1, len(self._outlook.commands)), np.float32)

    @property
    def privileged(self) -> bool:
        """Whether it reads ground truth."""
        return self._people.privileged

    def reset(self, which: Bool[np.ndarray, "B"]) -> None:
        """Forgets the marked worlds; their number sets the batch size."""
        self._people.reset(which)
        self._way.reset(which)
        self._worth = np.zeros((len(which), len(self._outlook.commands)), np.float32)

    def act(self, frame: SensorFrame) -> Command:
        """The command for each world.

        Raises:
            ValueError: for a frame of another number of worlds than `reset` announced, or without the truth needed.
        """
        require(frame.num_worlds == len(self._worth), "worlds", frame.num_worlds, f"{len(self._worth)}")
        everywhere = np.ones(frame.num_worlds, np.bool_)
        people = self._people.see(frame)
        self._way.see(frame, people)
        self._outlook.look(self._way.around(frame, people), everywhere, self._worth)
        chosen = self._outlook.commands[self._worth.argmax(axis=1)].astype(np.float32)
        return Command(chosen[:, 0], chosen[:, 1])
