"""Two forms, one meaning: the detector on images and true boxes with its errors, on the same episodes, side by side.

Training sees the second, robots the first: a policy may only be trained with one and run with the other where both
follow the same people, as well, and draw the same frames.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from densecavoid.frames import seen_from
from densecavoid.perception.config import PeopleFrom, PerceptionConfig
from densecavoid.perception.evaluation.driving import drive_about
from densecavoid.perception.evaluation.error_fit import match_people
from densecavoid.perception.pipeline import PeoplePipeline
from densecavoid.perception.prediction_frame import FREE
from densecavoid.perception.projection import camera_view
from densecavoid.perception.truth_detector import MIN_VISIBLE_FRACTION, visible_people
from densecavoid.scenarios import make_scenario
from densecavoid.sim.world import SimConfig, Simulator

FORMS: tuple[PeopleFrom, ...] = ("detector", "boxes", "truth")
NEAR_M = 0.5
"""A track within this of a person is theirs."""


@dataclass(frozen=True)
class FormsComparison:
    """Settings of the comparison."""

    scenarios: tuple[str, ...] = ("dense-ped", "corridor-15", "random-sparse-ped")
    worlds: int = 8
    """Of each scenario at once."""
    steps: int = 120
    """Control steps of each world."""
    horizon_s: float = 0.8
    seed: int = 0
    threads: int = 0


@dataclass
class FormScores:
    """How one form does."""

    people: int = 0
    """Sightings of people whom the camera shows (a third of the trunk)."""
    followed: int = 0
    """Those near whom there is a confirmed track."""
    errors_m: list[float] = field(default_factory=list)
    """Between track and person."""
    false_tracks: int = 0
    """Confirmed tracks near nobody, visible or not."""
    images: int = 0
    overlaps: list[float] = field(default_factory=list)
    """IoU of the prediction frame with the one from truth, where either shows anybody."""

    @property
    def recall(self) -> float:
        return self.followed / max(self.people, 1)

    def summary(self) -> dict[str, float]:
        """Recall, errors, false tracks an image, and the distribution of the frame's IoU with that from truth."""
        errors, overlaps = np.array(self.errors_m or [np.nan]), np.array(self.overlaps or [np.nan])
        return {
            "track_recall": self.recall,
            "error_median_m": float(np.median(errors)),
            "error_90_m": float(np.quantile(errors, 0.9)),
            "false_tracks_per_image": self.false_tracks / max(self.images, 1),
            "frame_iou_mean": float(overlaps.mean()),
            "frame_iou_25": float(np.quantile(overlaps, 0.25)),
            "frame_iou_50": float(np.quantile(overlaps, 0.5)),
            "frame_iou_75": float(np.quantile(overlaps, 0.75)),
        }


def compare_forms(
    config: FormsComparison | None = None, forms: tuple[PeopleFrom, ...] = FORMS
) -> dict[str, FormScores]:
    """Runs the same episodes through several forms; the overlaps are with `truth`, which must be among them."""
    config = config or FormsComparison()
    scores = {form: FormScores() for form in forms}
    for number, scenario in enumerate(config.scenarios):
        sim = Simulator(make_scenario(scenario), config.worlds, SimConfig(sensors="real", threads=config.threads))
        view, everybody = camera_view(sim.config.camera), np.ones(config.worlds, np.bool_)
        pipelines = {
            form: PeoplePipeline(
                PerceptionConfig(people_from=form, horizons_s=(config.horizon_s,), threads=config.threads),
                config.worlds,
            )
            for form in forms
        }
        for frame, _, fresh in drive_about(sim, config.steps, 1000 * config.seed + number):
            truth = frame.truth
            assert truth is not None
            for pipeline in pipelines.values():
                pipeline.reset(fresh)
                pipeline.update(frame, everybody)
            for b in range(config.worlds):
                active = truth.people.active[b]
                seen = visible_people(frame.depth_m[b], truth.robot_pose_w[b], truth.people, b, view)[active]
                places = seen_from(truth.robot_pose_w[b], truth.people.pos_w[b, active].astype(float))
                for form, pipeline in pipelines.items():
                    tracks = pipeline.tracks
                    mine = tracks.state[b, tracks.confirmed[b], :2]
                    _add(scores[form], seen_from(frame.odom_pose[b], mine), places, seen >= MIN_VISIBLE_FRACTION)
                    _add_overlap(scores[form], pipeline.prediction[b], pipelines["truth"].prediction[b])
    return scores


def _add(scores: FormScores, tracks: np.ndarray, people: np.ndarray, seen: np.ndarray) -> None:
    pairs = list(match_people(tracks, people, NEAR_M))
    scores.images += 1
    scores.people += int(seen.sum())
    scores.false_tracks += len(tracks) - len(pairs)
    for t, i in pairs:
        if seen[i]:
            scores.followed += 1
            scores.errors_m.append(float(np.hypot(*(tracks[t] - people[i]))))


def _add_overlap(scores: FormScores, frame: np.ndarray, true: np.ndarray) -> None:
    either = int(((frame < FREE) | (true < FREE)).sum())
    if either:
        scores.overlaps.append(int(((frame < FREE) & (true < FREE)).sum()) / either)
