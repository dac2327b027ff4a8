"""Where the camera's detections come from: the network on images, true boxes with the network's errors, or truth."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool

from densecavoid.frames import CameraConfig, SensorFrame, Truth
from densecavoid.perception.config import PerceptionConfig
from densecavoid.perception.detections import Detections, allocate_detections
from densecavoid.perception.error_model import GHOSTS, DetectorErrors, error_tables, find_with_errors, load_errors
from densecavoid.perception.networks import SHIPPED_DETECTOR
from densecavoid.perception.projection import camera_view
from densecavoid.perception.truth_detector import find_exactly
from densecavoid.sim._jit import for_worlds, threads_for


@runtime_checkable
class PeopleSource(Protocol):
    """Finds people in each world's image; keeps what memory it needs."""

    def reset(self, which: Bool[np.ndarray, "B"]) -> None:
        """Forgets the past of the marked worlds."""
        ...

    def find(self, frame: SensorFrame, which: Bool[np.ndarray, "B"]) -> Detections:
        """People in the images of the marked worlds, in arrays that the next call writes again."""
        ...

    def state_dict(self) -> dict[str, np.ndarray]:
        """Its memory."""
        ...

    def load_state_dict(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Goes on from a `state_dict`."""
        ...


def _truth(frame: SensorFrame, people_from: str) -> Truth:
    if frame.truth is None:
        raise ValueError(f"the frame has no ground truth, expected one for people_from={people_from!r} (a simulator's)")
    return frame.truth


class TruthSource:
    """Whoever the camera shows, exactly where they are. Privileged."""

    def __init__(self, config: PerceptionConfig, num_worlds: int) -> None:
        self._threads = config.threads
        self._view = camera_view(config.camera)
        self._found = allocate_detections(num_worlds)

    def reset(self, which: Bool[np.ndarray, "B"]) -> None:
        """Nothing to forget."""

    def find(self, frame: SensorFrame, which: Bool[np.ndarray, "B"]) -> Detections:
        """As `PeopleSource.find`.

        Raises:
            ValueError: if the frame has no truth.
        """
        truth = _truth(frame, "truth")
        poses = truth.robot_pose_w, frame.odom_pose
        threads = threads_for(which, self._threads)
        args = which, frame.depth_m, *poses, truth.people, self._view, self._found
        for_worlds(find_exactly, len(which), threads, *args)
        return self._found

    def state_dict(self) -> dict[str, np.ndarray]:
        """Nothing."""
        return {}

    def load_state_dict(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Nothing to load."""


class BoxSource:
    """Whoever the camera shows, missed and misplaced as the detector would. Privileged; for training.

    An episode's errors follow from its first frame (the goal and the robot's and the first person's place), so that
    they depend neither on the batch nor on the threads.
    """

    def __init__(self, config: PerceptionConfig, num_worlds: int, errors: DetectorErrors | None = None) -> None:
        self._dt = config.control_dt_s
        self._threads = config.threads
        self._view = camera_view(config.camera)
        self._tables = error_tables(errors or load_errors())
        self._found = allocate_detections(num_worlds)
        self._keys = np.zeros(num_worlds, np.uint64)
        self._step = np.full(num_worlds, -1, np.int64)
        self._ghosts = np.zeros((num_worlds, GHOSTS, 3))

    def reset(self, which: Bool[np.ndarray, "B"]) -> None:
        """As `PeopleSource.reset`."""
        self._step[which] = -1
        self._ghosts[which] = 0.0

    def find(self, frame: SensorFrame, which: Bool[np.ndarray, "B"]) -> Detections:
        """As `PeopleSource.find`.

        Raises:
            ValueError: if the frame has no truth.
        """
        truth = _truth(frame, "boxes")
        fresh = which & (self._step < 0)
        if fresh.any():
            first = truth.people.pos_w[:, :1].reshape(len(which), -1).astype(np.float64)
            start = np.concatenate([truth.robot_pose_w, frame.goal_odom, first], axis=1)[fresh]
            self._keys[fresh] = _key(np.ascontiguousarray(start))
        self._step[which] += 1
        for_worlds(
            find_with_errors,
            len(which),
            threads_for(which, self._threads),
            which,
            frame.depth_m,
            truth.robot_pose_w,
            frame.odom_pose,
            truth.people,
            self._keys,
            self._step,
            self._dt,
            self._tables,
            self._view,
            self._ghosts,
            self._found,
        )
        return self._found

    def state_dict(self) -> dict[str, np.ndarray]:
        """Keys, steps and false alarms."""
        return {"keys": self._keys.copy(), "step": self._step.copy(), "ghosts": self._ghosts.copy()}

    def load_state_dict(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Goes on from a `state_dict`."""
        self._keys[:], self._step[:], self._ghosts[:] = arrays["keys"], arrays["step"], arrays["ghosts"]


def _key(start: np.ndarray) -> np.ndarray:
    """64 bits from the bits of each row of numbers [N, K] (FNV-1a over words, Fowler, Noll, Vo)."""
    words = start.view(np.uint64)
    key = np.full(len(words), 0xCBF29CE484222325, np.uint64)
    for column in words.T:
        key = (key ^ column) * np.uint64(0x100000001B3)
        key ^= key >> np.uint64(29)
    return key


class ImageSource:
    """The network on each image: what a robot has."""

    def __init__(self, camera: CameraConfig, num_worlds: int, detector: str | Path = SHIPPED_DETECTOR) -> None:
        # Imported here so that what needs no network works where there is no ONNX Runtime.
        from densecavoid.perception.detector.detector import DepthDetector

        self._detector = DepthDetector(detector, camera)
        self._found = allocate_detections(num_worlds)

    def reset(self, which: Bool[np.ndarray, "B"]) -> None:
        """Nothing to forget."""

    def find(self, frame: SensorFrame, which: Bool[np.ndarray, "B"]) -> Detections:
        """As `PeopleSource.find`, one image after another."""
        for b in np.flatnonzero(which):
            one = self._detector.detect(frame.depth_m[b], frame.odom_pose[b])
            for mine, theirs in zip(self._found, one, strict=True):
                mine[b] = theirs[0]
        return self._found

    def state_dict(self) -> dict[str, np.ndarray]:
        """Nothing."""
        return {}

    def load_state_dict(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Nothing to load."""


def make_source(
    config: PerceptionConfig, num_worlds: int, detector: str | Path = SHIPPED_DETECTOR
) -> PeopleSource | None:
    """The source that the configuration names, with that detector if it needs one; None for nothing."""
    if config.people_from == "detector":
        return ImageSource(config.camera, num_worlds, detector)
    if config.people_from == "boxes":
        return BoxSource(config, num_worlds)
    if config.people_from == "truth":
        return TruthSource(config, num_worlds)
    return None
