"""Detections that a tracker is measured with when the detector shall not decide: truth with plain errors."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Bool

from densecavoid.frames import CameraConfig, SensorFrame, require
from densecavoid.perception.config import PerceptionConfig
from densecavoid.perception.detections import MAX_DETECTIONS, Detections
from densecavoid.perception.sources import TruthSource


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
        self._truth = TruthSource(PerceptionConfig(camera=self._camera), num_worlds)

    def reset(self, which: Bool[np.ndarray, "B"]) -> None:
        """Nothing to forget."""

    def find(self, frame: SensorFrame, which: Bool[np.ndarray, "B"]) -> Detections:
        """As `PeopleSource.find`.

        Raises:
            ValueError: if the frame has no truth.
        """
        camera, rng, found = self._camera, self._rng, self._truth.find(frame, which)
        for b in np.flatnonzero(which):
            kept = np.flatnonzero(rng.random(int(found.count[b])) >= self._missed)
            ghosts = rng.poisson(self._false)
            distance = rng.uniform(camera.min_range_m, camera.max_range_m, ghosts)
            bearing = frame.odom_pose[b, 2] + rng.uniform(-0.5, 0.5, ghosts) * camera.fov_horizontal_rad
            away = np.stack([np.cos(bearing), np.sin(bearing)], axis=1)
            places = found.pos[b, kept] + rng.normal(0.0, self._std_m, (len(kept), 2))
            places = np.vstack([places, frame.odom_pose[b, :2] + distance[:, None] * away])
            bodies = np.vstack([found.body[b, kept], np.full((ghosts, 2), np.nan)])
            n = min(len(places), MAX_DETECTIONS)
            found.pos[b, :n], found.body[b, :n] = places[:n], bodies[:n]
            found.std_m[b, :n], found.confidence[b, :n] = max(self._std_m, 0.01), 0.9
            found.count[b] = n
        return found

    def state_dict(self) -> dict[str, np.ndarray]:
        """Nothing: its dice go on wherever they are."""
        return {}

    def load_state_dict(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Nothing to load."""
