"""Where the detections come from that a tracker is measured with: the camera's network, or truth with plain errors."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool

from densecavoid.frames import CameraConfig, SensorFrame, require
from densecavoid.perception.detections import MAX_DETECTIONS, Detections, allocate_detections
from densecavoid.perception.truth_detector import detect_from_truth


@runtime_checkable
class Source(Protocol):
    """Finds people in each world's image."""

    def reset(self, which: Bool[np.ndarray, "B"]) -> None:
        """Forgets the past of the marked worlds."""
        ...

    def find(self, frame: SensorFrame, which: Bool[np.ndarray, "B"]) -> Detections:
        """People in the images of the marked worlds, in arrays that the next call writes again."""
        ...


class NetworkSource:
    """The depth detector on each image: what a robot has."""

    def __init__(self, num_worlds: int, camera: CameraConfig | None = None, detector: str = "depth-yolo") -> None:
        # Imported here so that all else works where there is no ONNX Runtime.
        from densecavoid.perception.detector.detector import DepthDetector

        self._detector = DepthDetector(detector, camera or CameraConfig())
        self._found = allocate_detections(num_worlds)

    def reset(self, which: Bool[np.ndarray, "B"]) -> None:
        """Nothing to forget."""

    def find(self, frame: SensorFrame, which: Bool[np.ndarray, "B"]) -> Detections:
        """As `Source.find`, one image after another."""
        for b in np.flatnonzero(which):
            one = self._detector.detect(frame.depth_m[b], frame.odom_pose[b])
            for mine, theirs in zip(self._found, one, strict=True):
                mine[b] = theirs[0]
        return self._found


class NoisyTruthSource:
    """Whoever the camera shows, by chance missed, misplaced, or joined by somebody who is not there. Privileged."""

    def __init__(
        self,
        num_worlds: int,
        camera: CameraConfig | None = None,
        missed: float = 0.1,
        std_m: float = 0.05,
        false_per_image: float = 0.02,
        seed: int = 0,
    ) -> None:
        """
        Args:
            num_worlds: B.
            camera: what shows the people.
            missed: share of people who are missed, each time anew.
            std_m: of x and of y.
            false_per_image: mean number of false alarms, anywhere in view.
            seed: of all that.
        """
        require(0.0 <= missed <= 1.0, "missed", missed, "in [0, 1]")
        require(std_m >= 0.0, "std_m", std_m, "0 or more")
        require(false_per_image >= 0.0, "false_per_image", false_per_image, "0 or more")
        self._camera = camera or CameraConfig()
        self._missed, self._std_m, self._false = missed, std_m, false_per_image
        self._rng = np.random.default_rng(seed)
        self._found = allocate_detections(num_worlds)
        self._seen = np.empty((MAX_DETECTIONS, 4))

    def reset(self, which: Bool[np.ndarray, "B"]) -> None:
        """Nothing to forget."""

    def find(self, frame: SensorFrame, which: Bool[np.ndarray, "B"]) -> Detections:
        """As `Source.find`.

        Raises:
            ValueError: if the frame has no truth.
        """
        require(frame.truth is not None, "frame.truth", None, "a simulator's")
        assert frame.truth is not None
        camera, rng, found = self._camera, self._rng, self._found
        people = frame.truth.people
        fixed = *map(float, camera.focal_px), float(camera.mount_height_m)
        for b in np.flatnonzero(which):
            who = people.pos_w[b].astype(float), people.radius_m[b].astype(float), people.height_m[b].astype(float)
            pose = frame.truth.robot_pose_w[b]
            count = detect_from_truth(frame.depth_m[b], pose, *who, people.active[b], *fixed, self._seen)
            rows = self._seen[:count][rng.random(count) >= self._missed]
            places = rows[:, :2] + rng.normal(0.0, self._std_m, (len(rows), 2))
            ghosts = rng.poisson(self._false)
            distance = rng.uniform(camera.min_range_m, camera.max_range_m, ghosts)
            bearing = rng.uniform(-0.5, 0.5, ghosts) * camera.fov_horizontal_rad
            places = np.vstack([places, np.column_stack([distance * np.cos(bearing), distance * np.sin(bearing)])])
            bodies = np.vstack([rows[:, 2:], np.full((ghosts, 2), np.nan)])
            n = min(len(places), MAX_DETECTIONS)
            x, y, yaw = frame.odom_pose[b]
            turn = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
            found.pos[b, :n] = places[:n] @ turn + (x, y)
            found.body[b, :n] = bodies[:n]
            found.std_m[b, :n], found.confidence[b, :n] = max(self._std_m, 0.01), 0.9
            found.count[b] = n
        return found
