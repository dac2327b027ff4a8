"""From sensors to the prediction frame: find people, follow them, foresee where they will be, draw it.

It keeps one memory a world. The same pipeline serves a robot (one world, the detector on its images) and training
(hundreds, true boxes with the detector's errors): only where detections come from differs.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Bool, UInt8

from densecavoid.frames import LidarConfig, SensorFrame
from densecavoid.perception.config import PerceptionConfig
from densecavoid.perception.detections import Detections
from densecavoid.perception.legs import LegDetector, load_forest
from densecavoid.perception.networks import PeopleNetworks
from densecavoid.perception.prediction_frame import FREE, Expected, draw_prediction, shades
from densecavoid.perception.predictor.contract import Histories, Predictor
from densecavoid.perception.predictor.registry import make_predictor
from densecavoid.perception.projection import camera_view
from densecavoid.perception.sources import PeopleSource, make_source
from densecavoid.perception.tracker import Sighting, Tracker
from densecavoid.perception.tracks import HISTORY, HISTORY_DT_S, Tracks
from densecavoid.perception.visibility import depth_view, lidar_view
from densecavoid.sim._jit import for_worlds, kernel, threads_for


@kernel
def _draw_all(first, last, which, image, expected, pose, velocity, horizons_s, shade, view, soft):
    for b in range(first, last):
        if which[b]:
            linear, angular = velocity[b, 0], velocity[b, 1]
            draw_prediction(image[b], expected, b, pose[b], linear, angular, horizons_s, shade, view, soft)


def expect_people(
    tracks: Tracks, predictor: Predictor, horizons_s: tuple[float, ...], which: Bool[np.ndarray, "B"]
) -> Expected:
    """Where the people whom the marked worlds are sure of will be."""
    world, slot = np.nonzero(tracks.confirmed & which[:, None])
    state = tracks.state[world, slot]
    pos = tracks.history[world, slot].astype(np.float64)
    pos[:, -1] = state[:, :2]
    filled = np.arange(HISTORY)[None] >= HISTORY - np.maximum(tracks.history_count[world, slot], 1)[:, None]
    histories = Histories(pos, filled, world, state[:, 2:], HISTORY_DT_S)
    mean, covariance = predictor.predict(histories, horizons_s)
    first = np.searchsorted(world, np.arange(len(which) + 1))
    return Expected(np.asarray(mean, float), np.asarray(covariance, float), tracks.body[world, slot], first)


def sees_legs(lidar: LidarConfig) -> bool:
    """Whether a scanner is level and at the height of shins, as the leg detector needs it."""
    return lidar.mount_pitch_rad == 0.0 and 0.1 <= lidar.mount_height_m <= 0.45


class PeoplePipeline:
    """Perception of B worlds."""

    def __init__(
        self,
        config: PerceptionConfig,
        num_worlds: int,
        source: PeopleSource | None = None,
        predictor: Predictor | None = None,
        networks: PeopleNetworks = PeopleNetworks(),
    ) -> None:
        """
        Args:
            config: how people are perceived.
            num_worlds: B.
            source: where detections come from, instead of what the configuration names.
            predictor: the same of predictions.
            networks: the files of what the configuration names.

        Raises:
            ValueError: if a file is none of its kind, or the predictor does not look as far as the horizons.
        """
        self.config = config
        self.source = source or make_source(config, num_worlds, networks.detector)
        self.predictor = predictor or make_predictor(config.predictor, networks.predictor)
        self.prediction: UInt8[np.ndarray, "B height width"] = np.full(
            (num_worlds, config.camera.height, config.camera.width), FREE, np.uint8
        )
        """The prediction frame of each world."""
        self._num_worlds = num_worlds
        self._view = camera_view(config.camera)
        self._horizons = np.array(config.horizons_s)
        self._shades = shades(len(config.horizons_s))
        self._tracker = Tracker(num_worlds, config.threads)
        # Exact places need no legs; neither does a scanner that sees none.
        with_legs = config.people_from in ("detector", "boxes") and sees_legs(config.lidar)
        forest = load_forest(networks.legs) if with_legs and networks.legs is not None else None
        self._legs = LegDetector(config.lidar, num_worlds, config.threads, forest) if with_legs else None
        # Of nobody: what it cannot foresee is said now, and not when the first person comes.
        expect_people(self._tracker.tracks, self.predictor, config.horizons_s, np.zeros(num_worlds, np.bool_))

    @property
    def tracks(self) -> Tracks:
        """Everybody followed now."""
        return self._tracker.tracks

    def reset(self, which: Bool[np.ndarray, "B"]) -> None:
        """Forgets the past of the marked worlds."""
        self.prediction[which] = FREE
        self._tracker.reset(which)
        if self.source is not None:
            self.source.reset(which)

    def update(self, frame: SensorFrame, which: Bool[np.ndarray, "B"]) -> None:
        """Takes in the next frame of the marked worlds and draws their prediction frames.

        Raises:
            ValueError: if the frame lacks the truth that the configuration needs.
        """
        if self.source is None:
            return
        self.track(frame, self.source.find(frame, which), self.find_legs(frame, which), which)
        self.draw(frame, expect_people(self.tracks, self.predictor, self.config.horizons_s, which), which)

    def find_legs(self, frame: SensorFrame, which: Bool[np.ndarray, "B"]) -> Detections | None:
        """People by their legs in the marked worlds' scans; None where legs are not looked for."""
        return None if self._legs is None else self._legs.detect(frame.scan_m, frame.odom_pose, which)

    def track(
        self, frame: SensorFrame, found: Detections, legs: Detections | None, which: Bool[np.ndarray, "B"]
    ) -> Tracks:
        """Takes the detections of camera and lidar into the tracks."""
        sightings = [Sighting(found, depth_view(frame.depth_m, self.config.camera))]
        if legs is not None:
            sightings.append(Sighting(legs, lidar_view(frame.scan_m, self.config.lidar)))
        return self._tracker.update(frame.odom_pose, self.config.control_dt_s, sightings, which)

    def draw(self, frame: SensorFrame, expected: Expected, which: Bool[np.ndarray, "B"]) -> None:
        """Draws the marked worlds' prediction frames."""
        threads = threads_for(which, self.config.threads)
        moving = self.prediction, expected, frame.odom_pose, frame.velocity
        how = self._horizons, self._shades, self._view, self.config.soft
        for_worlds(_draw_all, self._num_worlds, threads, which, *moving, *how)

    def state_dict(self) -> dict[str, np.ndarray]:
        """The memory of all worlds, as arrays."""
        arrays = {f"tracks.{name}": value for name, value in self._tracker.state_dict().items()}
        if self.source is not None:
            arrays |= {f"source.{name}": value for name, value in self.source.state_dict().items()}
        return arrays | {"prediction": self.prediction.copy()}

    def load_state_dict(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Goes on from a `state_dict`."""
        self._tracker.load_state_dict(_part(arrays, "tracks."))
        if self.source is not None:
            self.source.load_state_dict(_part(arrays, "source."))
        self.prediction[:] = arrays["prediction"]


def _part(arrays: Mapping[str, np.ndarray], prefix: str) -> dict[str, np.ndarray]:
    return {name.removeprefix(prefix): value for name, value in arrays.items() if name.startswith(prefix)}
