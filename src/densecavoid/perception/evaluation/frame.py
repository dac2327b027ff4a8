"""How true the prediction frame is: the frame that each predictor draws beside the one that the truth gives, later on.

Predicted is what the pipeline draws from detected tracks, in the image that the camera will have if the robot keeps its
velocity. True is where the same people then are, in the image that the camera then has. Both are scored by their
intersection over union.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from densecavoid.frames import CameraConfig, People, SensorFrame, require
from densecavoid.perception.config import PeopleFrom, PerceptionConfig
from densecavoid.perception.evaluation.driving import drive_about
from densecavoid.perception.pipeline import PeoplePipeline, expect_people
from densecavoid.perception.prediction_frame import FREE, Expected, draw_prediction
from densecavoid.perception.predictor.contract import Predictor
from densecavoid.perception.projection import CameraView, camera_view
from densecavoid.perception.truth_detector import MIN_VISIBLE_FRACTION, visible_people
from densecavoid.scenarios import make_scenario
from densecavoid.sim.world import SimConfig, Simulator

REMEMBERED_S = 1.0
"""People whom the camera has shown within this time are to be foreseen."""
_BLACK = np.zeros(1, np.uint8)


@dataclass(frozen=True)
class FrameEvaluation:
    """Settings of the measurement."""

    scenarios: tuple[str, ...] = ("dense-ped", "corridor-15", "random-sparse-ped")
    people_from: PeopleFrom = "detector"
    horizons_s: tuple[float, ...] = (0.1, 0.4, 1.2)
    worlds: int = 8
    """Of each scenario at once; ended episodes begin anew."""
    steps: int = 150
    """Control steps of each world."""
    seed: int = 0
    threads: int = 0

    def __post_init__(self) -> None:
        for name in ("worlds", "steps"):
            require(getattr(self, name) >= 1, f"FrameEvaluation.{name}", getattr(self, name), "at least 1")
        require(len(self.scenarios) > 0, "FrameEvaluation.scenarios", self.scenarios, "one or more")


class Overlaps:
    """Intersections over unions of one predictor at one horizon."""

    def __init__(self) -> None:
        self.values: list[float] = []
        self.people: list[int] = []
        """In the true frame."""

    def add(self, predicted: np.ndarray, true: np.ndarray, ignored: np.ndarray, people: int) -> None:
        """Scores one pair of frames [height, width]; pixels of `ignored` people count only where somebody else is."""
        ours, theirs = (predicted < FREE) & ~(ignored & ~true), true
        union = int((ours | theirs).sum())
        if union > 0:
            self.values.append(int((ours & theirs).sum()) / union)
            self.people.append(people)

    @property
    def mean(self) -> float:
        return float(np.mean(self.values)) if self.values else float("nan")


def evaluate_frames(
    predictors: Mapping[str, Predictor], config: FrameEvaluation | None = None
) -> dict[str, dict[float, Overlaps]]:
    """Drives robots through crowds and scores every predictor at every horizon, on the same tracks.

    Frames in which nobody is seen and nobody is expected are left out. People whom the camera has not shown for a
    second or more are neither asked for nor held against those who draw them.

    Args:
        predictors: by the names of the results.
        config: the rest.

    Returns:
        For each predictor and horizon the scores of all frames.
    """
    config = config or FrameEvaluation()
    scores = {name: {horizon: Overlaps() for horizon in config.horizons_s} for name in predictors}
    for number, scenario in enumerate(config.scenarios):
        sim = Simulator(make_scenario(scenario), config.worlds, SimConfig(sensors="real", threads=config.threads))
        _Drive(sim, predictors, config, scores, config.seed * 100 + number).run()
    return scores


class _Drive:
    """One scenario's worlds, and the predictions that wait for their time to come."""

    def __init__(
        self,
        sim: Simulator,
        predictors: Mapping[str, Predictor],
        config: FrameEvaluation,
        scores: dict[str, dict[float, Overlaps]],
        seed: int,
    ) -> None:
        self._sim, self._config, self._scores, self._predictors = sim, config, scores, predictors
        perception = PerceptionConfig(
            sim.config.lidar, sim.config.camera, people_from=config.people_from, threads=config.threads
        )
        self._pipeline = PeoplePipeline(perception, sim.num_worlds)
        self._view = camera_view(sim.config.camera)
        self._seed = seed
        self._seen: list[dict[int, float]] = [{} for _ in range(sim.num_worlds)]
        dt = sim.config.control_dt_s
        self._steps_ahead = {horizon: round(horizon / dt) for horizon in config.horizons_s}
        self._waiting: dict[float, deque[tuple[np.ndarray, dict[str, np.ndarray], list[set[int]]]]] = {
            horizon: deque() for horizon in config.horizons_s
        }

    def run(self) -> None:
        everybody = np.ones(self._sim.num_worlds, np.bool_)
        for frame, episode, fresh in drive_about(self._sim, self._config.steps, self._seed):
            self._pipeline.reset(fresh)
            for b in np.flatnonzero(fresh):
                self._seen[b].clear()
            self._pipeline.update(frame, everybody)
            self._score(frame, episode)
            self._foresee(frame, episode)

    def _foresee(self, frame: SensorFrame, episode: np.ndarray) -> None:
        truth = frame.truth
        assert truth is not None
        known: list[set[int]] = []
        for b, seen in enumerate(self._seen):
            shares = visible_people(frame.depth_m[b], truth.robot_pose_w[b], truth.people, b, self._view)
            for i in np.flatnonzero(shares >= MIN_VISIBLE_FRACTION):
                seen[int(truth.people.id[b, i])] = float(frame.time_s[b])
            known.append({i for i, when in seen.items() if frame.time_s[b] - when <= REMEMBERED_S})
        which = np.ones(len(known), np.bool_)
        for horizon, waiting in self._waiting.items():
            images = {}
            for name, predictor in self._predictors.items():
                expected = expect_people(self._pipeline.tracks, predictor, (horizon,), which)
                images[name] = self._draw(expected, frame, horizon)
            waiting.append((episode.copy(), images, known))

    def _draw(self, expected: Expected, frame: SensorFrame, horizon: float) -> np.ndarray:
        camera = self._sim.config.camera
        image = np.empty((frame.num_worlds, camera.height, camera.width), np.uint8)
        ahead = np.array([horizon])
        for b in range(frame.num_worlds):
            velocity = float(frame.velocity[b, 0]), float(frame.velocity[b, 1])
            draw_prediction(image[b], expected, b, frame.odom_pose[b], *velocity, ahead, _BLACK, self._view, False)
        return image

    def _score(self, frame: SensorFrame, episode: np.ndarray) -> None:
        """Scores the predictions that were made for now."""
        truth = frame.truth
        assert truth is not None
        for horizon, waiting in self._waiting.items():
            if len(waiting) < self._steps_ahead[horizon]:
                continue
            then, images, known = waiting.popleft()
            for b in np.flatnonzero(then == episode).tolist():
                asked = np.isin(truth.people.id[b], list(known[b])) & truth.people.active[b]
                pose = truth.robot_pose_w[b]
                true = draw_people(truth.people, b, asked, pose, self._sim.config.camera, self._view)
                others = truth.people.active[b] & ~asked
                ignored = draw_people(truth.people, b, others, pose, self._sim.config.camera, self._view)
                for name, scores in self._scores.items():
                    scores[horizon].add(images[name][b], true, ignored, int(asked.sum()))


def draw_people(
    people: People, b: int, which: np.ndarray, pose: np.ndarray, camera: CameraConfig, view: CameraView
) -> np.ndarray:
    """bool [height, width]: where those marked of world b are in the image of a camera on a robot at `pose`."""
    pos = people.pos_w[b, which][:, None].astype(np.float64)
    body = np.stack([people.radius_m[b, which], people.height_m[b, which]], axis=1).astype(np.float64)
    expected = Expected(pos, np.zeros((*pos.shape[:2], 3)), body, np.array([0, len(pos)]))
    image = np.empty((camera.height, camera.width), np.uint8)
    draw_prediction(image, expected, 0, pose, 0.0, 0.0, np.zeros(1), _BLACK, view, False)
    return image < FREE


def frame_table(
    scores: Mapping[str, Mapping[float, Overlaps]], horizons_s: Sequence[float]
) -> dict[str, dict[str, float]]:
    """Mean IoU of each predictor, `iou_<horizon>`."""
    return {name: {f"iou_{horizon:g}": of[horizon].mean for horizon in horizons_s} for name, of in scores.items()}
