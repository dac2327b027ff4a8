"""From sensor frames to the policy's observation: scan history, nearness image, tracks and the prediction frame.

The same observer serves training, benchmark and robot; it keeps one memory for each world.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from jaxtyping import Bool

from densecavoid.frames import CameraConfig, LidarConfig, Observation, SensorFrame, choose, goal_polar, require
from densecavoid.perception.detections import allocate_detections
from densecavoid.perception.prediction_frame import FREE, draw_prediction
from densecavoid.perception.tracker import Sighting, Tracker
from densecavoid.perception.tracks import Tracks
from densecavoid.perception.truth_detector import detect_from_truth
from densecavoid.perception.visibility import camera_view
from densecavoid.sim._jit import for_worlds, kernel, threads_for

SCANS = 3
"""Consecutive scans in an observation (paper, Fig. 3)."""


@dataclass(frozen=True)
class ObserverConfig:
    """What the policy gets to see."""

    lidar: LidarConfig = field(default_factory=LidarConfig)
    camera: CameraConfig = field(default_factory=CameraConfig)
    people_from: Literal["truth", "nothing"] = "truth"
    """truth: boxes of visible people from ground truth, tracked and predicted. nothing: an empty prediction frame."""
    horizon_s: float = 0.8
    """How far ahead the prediction frame looks."""
    control_dt_s: float = 0.1
    threads: int = 0

    def __post_init__(self) -> None:
        choose("ObserverConfig.people_from", self.people_from, ("truth", "nothing"))
        require(0.0 <= self.horizon_s <= 5.0, "ObserverConfig.horizon_s", self.horizon_s, "in [0, 5] s")
        if self.people_from != "nothing":
            # People's boxes are drawn for a level camera over the robot's centre (perception/projection.py).
            mount = (self.camera.mount_x_m, self.camera.mount_pitch_rad)
            require(
                mount == (0.0, 0.0), "camera's (mount_x_m, mount_pitch_rad)", mount, "(0, 0), or people_from nothing"
            )
        require(self.control_dt_s > 0, "ObserverConfig.control_dt_s", self.control_dt_s, "positive")

    @property
    def privileged(self) -> bool:
        """Whether ground truth is needed."""
        return self.people_from == "truth"


@kernel
def _observe(
    first,
    last,
    which,
    fresh,
    scan,
    depth,
    lidar_range,
    camera_min,
    camera_max,
    lidar,
    camera,
):
    """Shifts the scans and turns depth into nearness."""
    scale = np.float32(254.0 / (camera_max - camera_min))
    for b in range(first, last):
        if not which[b]:
            continue
        for r in range(scan.shape[1]):
            near = min(scan[b, r] / lidar_range, np.float32(1.0))
            if fresh[b]:
                lidar[b, 0, r] = lidar[b, 1, r] = near
            else:
                lidar[b, 0, r], lidar[b, 1, r] = lidar[b, 1, r], lidar[b, 2, r]
            lidar[b, 2, r] = near
        for v in range(depth.shape[1]):
            for u in range(depth.shape[2]):
                d = depth[b, v, u]
                inside = camera_min <= d <= camera_max  # NaN is not
                camera[b, v, u] = np.uint8(1.5 + scale * (camera_max - d)) if inside else np.uint8(0)


_TRUTH_STD_M, _TRUTH_CONFIDENCE = 0.05, 0.99


@kernel
def _find_people(
    first, last, which, depth, odom_pose, true_pose, pos, radius, height, active, focal_x, focal_y, camera_height, out
):
    """Detects the people of each world from truth."""
    found = np.empty((out.pos.shape[1], 4))
    for b in range(first, last):
        if not which[b]:
            continue
        count = detect_from_truth(
            depth[b], true_pose[b], pos[b], radius[b], height[b], active[b], focal_x, focal_y, camera_height, found
        )
        pose = odom_pose[b]
        cos, sin = np.cos(pose[2]), np.sin(pose[2])
        for d in range(count):
            forward, left = found[d, 0], found[d, 1]
            out.pos[b, d, 0] = pose[0] + cos * forward - sin * left
            out.pos[b, d, 1] = pose[1] + sin * forward + cos * left
            out.body[b, d, 0], out.body[b, d, 1] = found[d, 2], found[d, 3]
            out.std_m[b, d], out.confidence[b, d] = _TRUTH_STD_M, _TRUTH_CONFIDENCE
        out.count[b] = count


@kernel
def _draw_people(
    first, last, which, tracks, odom_pose, velocity, horizon_s, focal_x, focal_y, camera_height, prediction
):
    """Draws each world's prediction frame."""
    for b in range(first, last):
        if which[b]:
            v, w = velocity[b, 0], velocity[b, 1]
            draw_prediction(prediction[b], tracks, b, odom_pose[b], v, w, horizon_s, focal_x, focal_y, camera_height)


class Observer:
    """Turns frames into observations, one memory a world."""

    def __init__(self, config: ObserverConfig, num_worlds: int) -> None:
        require(num_worlds >= 1, "num_worlds", num_worlds, "at least 1")
        self.config = config
        self.num_worlds = num_worlds
        self.privileged = config.privileged
        shape = (num_worlds, config.camera.height, config.camera.width)
        self._fresh = np.ones(num_worlds, np.bool_)
        self._lidar = np.ones((num_worlds, SCANS, config.lidar.num_rays), np.float32)
        self._camera = np.zeros(shape, np.uint8)
        self._prediction = np.full(shape, FREE, np.uint8)
        self._tracker = Tracker(num_worlds, config.threads)
        self._found = allocate_detections(num_worlds)

    @property
    def tracks(self) -> Tracks:
        """Everybody tracked now."""
        return self._tracker.tracks

    def reset(self, which: Bool[np.ndarray, "B"]) -> None:
        """Forgets the past of the marked worlds."""
        self._fresh[which] = True
        self._prediction[which] = FREE
        self._tracker.reset(which)

    def observe(self, frame: SensorFrame, which: Bool[np.ndarray, "B"] | None = None) -> Observation:
        """Takes in the next frame of the marked worlds (all, without `which`).

        Returns:
            The observation of all worlds, in buffers that the next call writes again.

        Raises:
            ValueError: if the frame does not fit the configured sensors, or lacks the truth that they need.
        """
        config = self.config
        self._check(frame)
        which = np.ones(self.num_worlds, np.bool_) if which is None else which
        threads = threads_for(which, config.threads)
        for_worlds(
            _observe,
            self.num_worlds,
            threads,
            which,
            self._fresh,
            frame.scan_m,
            frame.depth_m,
            np.float32(config.lidar.max_range_m),
            np.float32(config.camera.min_range_m),
            np.float32(config.camera.max_range_m),
            self._lidar,
            self._camera,
        )
        if config.people_from == "truth" and frame.truth is not None:
            people = frame.truth.people
            camera = (*config.camera.focal_px, config.camera.mount_height_m)
            for_worlds(
                _find_people,
                self.num_worlds,
                threads,
                which,
                frame.depth_m,
                frame.odom_pose,
                frame.truth.robot_pose_w,
                people.pos_w,
                people.radius_m,
                people.height_m,
                people.active,
                *camera,
                self._found,
            )
            seen = Sighting(self._found, camera_view(frame.depth_m, config.camera))
            self._tracker.update(frame.odom_pose, config.control_dt_s, [seen], which)
            for_worlds(
                _draw_people,
                self.num_worlds,
                threads,
                which,
                self.tracks,
                frame.odom_pose,
                frame.velocity,
                config.horizon_s,
                *camera,
                self._prediction,
            )
        self._fresh[which] = False
        distance, bearing = goal_polar(frame.odom_pose, frame.goal_odom)
        return Observation(
            lidar=self._lidar,
            camera=self._camera,
            goal=np.stack([distance, bearing], axis=1).astype(np.float32),
            velocity=frame.velocity.astype(np.float32),
            prediction=self._prediction,
        )

    def state_dict(self) -> dict[str, np.ndarray]:
        """The memory of all worlds, as arrays."""
        arrays = {f"tracks.{name}": value for name, value in self._tracker.state_dict().items()}
        return arrays | {
            "fresh": self._fresh.copy(),
            "lidar": self._lidar.copy(),
            "camera": self._camera.copy(),
            "prediction": self._prediction.copy(),
        }

    def load_state_dict(self, arrays: dict[str, np.ndarray]) -> None:
        """Goes on from a `state_dict`."""
        require(len(arrays["fresh"]) == self.num_worlds, "saved worlds", len(arrays["fresh"]), str(self.num_worlds))
        prefix = "tracks."
        tracks = {name.removeprefix(prefix): value for name, value in arrays.items() if name.startswith(prefix)}
        self._tracker.load_state_dict(tracks)
        self._fresh, self._lidar = np.array(arrays["fresh"]), np.array(arrays["lidar"])
        self._camera, self._prediction = np.array(arrays["camera"]), np.array(arrays["prediction"])

    def _check(self, frame: SensorFrame) -> None:
        camera = self.config.camera
        scan_shape = (self.num_worlds, self.config.lidar.num_rays)
        depth_shape = (self.num_worlds, camera.height, camera.width)
        require(frame.scan_m.shape == scan_shape, "scan_m", frame.scan_m.shape, str(scan_shape))
        require(frame.depth_m.shape == depth_shape, "depth_m", frame.depth_m.shape, str(depth_shape))
        if self.config.privileged and frame.truth is None:
            raise ValueError("the frame has no ground truth, expected one for people_from='truth' (a simulator's)")
