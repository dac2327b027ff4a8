"""An exported folder (`policy.folder`) as a robot runs it: a pilot of one robot that says whom it tracks."""

from __future__ import annotations

import importlib
from pathlib import Path

import numpy as np

from densecavoid.frames import (
    CameraConfig,
    LidarConfig,
    Observation,
    RobotConfig,
    SensorFrame,
    into_robot_frame,
    seen_from,
)
from densecavoid.perception.legs import LegDetector, load_forest
from densecavoid.perception.pipeline import expect_people
from densecavoid.perception.prediction_frame import Expected
from densecavoid.perception.tracker import Sighting, Tracker
from densecavoid.perception.tracks import Tracks
from densecavoid.perception.visibility import lidar_view
from densecavoid.policy.folder import open_folder
from densecavoid.policy.navigator import PolicyNavigator
from densecavoid.safety import NOBODY, PeopleNear


class FolderPilot:
    """The navigator of an exported folder, as a robot runs it: a batch of one, without ground truth."""

    def __init__(self, folder: Path, robot: RobotConfig | None = None) -> None:
        """Loads and checks the folder.

        Args:
            folder: as exported.
            robot: whom it drives, as `PolicyNavigator`.

        Raises:
            ValueError, OSError: naming what is wrong with it.
        """
        opened = open_folder(folder)
        self._navigator = PolicyNavigator(opened.policy, networks=opened.networks, robot=robot)
        # Where the policy's observer tracks nobody, the filter still wants to know who walks where: legs in the scans.
        self._legs: LegDetector | None = None
        if self._navigator.observer_config.people_from == "nothing":
            assert opened.networks.legs is not None
            self._legs = LegDetector(self.lidar, threads=1, forest=load_forest(opened.networks.legs))
            self._tracker = Tracker(1, threads=1)
            importlib.import_module("scipy.optimize")  # now, and not when the tracker first needs it
        self.name = opened.name

    @property
    def lidar(self) -> LidarConfig:
        """The scanner that it was trained with."""
        return self._navigator.observer_config.lidar

    @property
    def camera(self) -> CameraConfig:
        """The camera that it was trained with."""
        return self._navigator.observer_config.camera

    def reset(self) -> None:
        """Forgets scans and tracks."""
        self._navigator.reset(np.ones(1, np.bool_))
        if self._legs is not None:
            self._tracker.reset(np.ones(1, np.bool_))

    def act(self, frame: SensorFrame) -> tuple[float, float]:
        """The policy's command."""
        command = self._navigator.act(frame)
        if self._legs is not None:
            found = Sighting(self._legs.detect(frame.scan_m, frame.odom_pose), lidar_view(frame.scan_m, self.lidar))
            self._tracker.update(frame.odom_pose, self._navigator.observer_config.control_dt_s, [found])
        return float(command.linear_velocity[0]), float(command.angular_velocity[0])

    @property
    def observation(self) -> Observation | None:
        """What the policy acted on last, in buffers that the next act writes again."""
        return self._navigator.observation

    @property
    def noise(self) -> np.ndarray | None:
        """What the last command was drawn with; none if it is the policy's likeliest."""
        return self._navigator.noise

    @property
    def tracks(self) -> Tracks:
        """Everybody tracked, a batch of one."""
        return self._navigator.tracks if self._legs is None else self._tracker.tracks

    def expected(self, horizons_s: tuple[float, ...]) -> Expected:
        """Where everybody who is surely a person will be, in the order of their tracks."""
        return expect_people(self.tracks, self._navigator.predictor, horizons_s, np.ones(1, np.bool_))

    def prediction(self) -> np.ndarray | None:
        """What the policy saw of where people will be."""
        observation = self._navigator.observation
        return None if observation is None else observation.prediction[0].copy()

    def people(self, pose: tuple[float, float, float]) -> PeopleNear:
        """Everybody who is surely a person."""
        tracks = self.tracks
        some, where = np.flatnonzero(tracks.confirmed[0]), np.array(pose)
        if len(some) == 0:
            return NOBODY
        pos, vel = tracks.state[0, some, :2], tracks.state[0, some, 2:]
        return PeopleNear(seen_from(where, pos), into_robot_frame(where[..., 2], vel), tracks.body[0, some, 0].copy())
