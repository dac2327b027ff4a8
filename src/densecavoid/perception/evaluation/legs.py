"""How well people are found by their legs: on real scans and on simulated ones, beside a rule of the literature.

A position counts when it is within .5 m of a person's; each person and each position counts once.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.optimize import linear_sum_assignment
from scipy.sparse.csgraph import connected_components

from densecavoid.frames import CameraConfig, Command, LidarConfig
from densecavoid.perception.leg_recordings import (
    LegRecording,
    empty_rooms,
    followed_person,
    half_of,
    labelled_legs,
)
from densecavoid.perception.leg_segments import FEATURES
from densecavoid.perception.leg_training import CHOSEN_ON, TRAINED_ON
from densecavoid.perception.legs import Forest, LegDetector, shipped_forest
from densecavoid.scenarios import make_scenario
from densecavoid.sim.people import LEFT_LEG, RIGHT_LEG
from densecavoid.sim.world import SimConfig, Simulator

MATCH_M = 0.5
CONFIDENCE = 0.5
"""From which a position counts as reported."""
TESTS = ("dense-ped", "random-sparse-ped", "dense-static")
_LABELLED_RAD, _LABELLED_M = np.radians(15.0), 5.0  # where everybody is labelled in the recordings

PUBLISHED = {
    "ROS leg detector": {"ap": 0.273, "f1": 0.367},
    "Arras et al., re-trained": {"ap": 0.437, "f1": 0.476},
    "Leigh et al., re-trained": {"ap": 0.552, "f1": 0.563},
}
"""Average precision and best F1 at .5 m of the published leg detectors on another data set, DROW, as Yang et al. report
them (Li2Former, IEEE Trans. Instrumentation and Measurement 73). Leigh et al. themselves report tracks, not positions.
Not comparable digit by digit: they say how far legs in single scans carry."""


def rule_of_thumb() -> Forest:
    """The simplest kind of detector in print, thresholds on size and shape (as Xavier et al., ICRA 2005), as one tree.

    A leg is between 5 and 25 cm wide, fits a circle of less than 15 cm radius, and stands out by 10 cm at both sides.
    """
    tests = (("width_m", 0.05, 1), ("width_m", 0.25, 0), ("circle_radius_m", 0.15, 0))
    tests += (("jump_right_m", 0.1, 1), ("jump_left_m", 0.1, 1))
    feature = [FEATURES.index(name) for level, (name, _, _) in enumerate(tests) for _ in range(2**level)]
    threshold = [at for level, (_, at, _) in enumerate(tests) for _ in range(2**level)]
    leaf = int("".join(str(side) for _, _, side in tests), 2)
    value = np.full((1, 2 ** len(tests)), -3.0)
    value[0, leaf] = 1.0
    return Forest(np.array([feature], np.int32), np.array([threshold]), value, 0.0)


@dataclass(frozen=True)
class Found:
    """Positions reported in a set of scans, and how many people there were to report."""

    confidence: Float[np.ndarray, "n"]
    right: Float[np.ndarray, "n"]
    """1 where a person was, else 0."""
    error_m: Float[np.ndarray, "n"]
    people: int
    scans: int

    def summary(self) -> dict[str, float]:
        """Precision, recall, F1 at `CONFIDENCE`, average precision, median error (m), false positions a scan."""
        sure = self.confidence >= CONFIDENCE
        right, reported = self.right[sure].sum(), sure.sum()
        precision, recall = right / max(reported, 1), right / max(self.people, 1)
        order = np.argsort(-self.confidence, kind="stable")
        hits = np.cumsum(self.right[order])
        precisions, recalls = hits / np.arange(1, len(hits) + 1), hits / max(self.people, 1)
        best = np.maximum.accumulate(precisions[::-1])[::-1]
        error = self.error_m[sure & (self.right > 0)]
        return {
            "precision": float(precision),
            "recall": float(recall),
            "f1": float(2 * precision * recall / max(precision + recall, 1e-9)),
            "ap": float(np.sum(np.diff(recalls, prepend=0.0) * best)),
            "best_f1": float((2 * hits / (np.arange(1, len(hits) + 1) + self.people)).max(initial=0.0)),
            "error_m": float(np.median(error)) if len(error) else float("nan"),
            "false_per_scan": float((reported - right) / self.scans),
            "people": float(self.people),
            "scans": float(self.scans),
        }


def match(
    found: Float[np.ndarray, "n 2"],
    confidence: Float[np.ndarray, "n"],
    people: Float[np.ndarray, "m 2"],
    others: Float[np.ndarray, "k 2"] | None = None,
) -> Found:
    """Judges the positions of one scan. Those near `others`, who may or may not be reported, do not count."""
    apart = np.hypot(*(found[:, None] - people[None]).transpose(2, 0, 1))
    right, error = np.zeros(len(found)), np.full(len(found), np.nan)
    # Most matches, and of those the nearest: what does not match is pushed out of reach.
    cost = np.where(apart < MATCH_M, apart, 10.0)
    for row, column in zip(*linear_sum_assignment(cost), strict=True):
        if apart[row, column] < MATCH_M:
            right[row], error[row] = 1.0, apart[row, column]
    counts = np.ones(len(found), bool)
    if others is not None and len(others):
        counts = (right > 0) | (np.hypot(*(found[:, None] - others[None]).transpose(2, 0, 1)).min(axis=1) > MATCH_M)
    return Found(confidence[counts], right[counts], error[counts], len(people), 1)


def pooled(parts: list[Found]) -> Found:
    """Several scans as one set."""
    columns = (np.concatenate([getattr(p, name) for p in parts]) for name in ("confidence", "right", "error_m"))
    return Found(*columns, people=sum(p.people for p in parts), scans=sum(p.scans for p in parts))


def people_of(labels: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "people 2"]:
    """Places of people from labels of their legs' clusters: the middles of chains less than .8 m apart."""
    apart = np.hypot(*(labels[:, None] - labels[None]).transpose(2, 0, 1))
    count, label = connected_components(apart < 0.8)
    return np.array([labels[label == k].mean(axis=0) for k in range(count)]).reshape(-1, 2)


def on_recording(recording: LegRecording, forest: Forest, everywhere: bool) -> Found:
    """Positions in each scan of a recording.

    Args:
        everywhere: what is reported counts wherever it is; otherwise where the recording has all people labelled.
    """
    detector = LegDetector(recording.lidar, 1, 1, forest)
    parts = []
    for scan, pose, labels in zip(recording.scans_m, recording.pose, recording.labels, strict=True):
        out = detector.detect(scan[None], pose[None])
        n = out.count[0]
        found, confidence = out.pos[0, :n].copy(), out.confidence[0, :n].copy()
        people = people_of(labels)
        if not everywhere:
            inside = np.abs(np.arctan2(found[:, 1], found[:, 0])) < _LABELLED_RAD
            inside &= np.hypot(*found.T) < _LABELLED_M
            near = np.hypot(*(found[:, None] - people[None]).transpose(2, 0, 1)).min(axis=1, initial=np.inf) < MATCH_M
            found, confidence = found[inside | near], confidence[inside | near]
        parts.append(match(found, confidence, people))
    return pooled(parts)


def in_simulation(
    scenario: str, forest: Forest, lidar: LidarConfig | None = None, worlds: int = 16, seed: int = 10_000
) -> Found:
    """Positions in `real` scans of simulated worlds, judged against everybody of whose legs three rays or more return
    within the lidar's range. Those of whom less is seen do not count, reported or not."""
    lidar = lidar or LidarConfig()
    config = SimConfig(lidar=lidar, camera=CameraConfig(width=4, height=4), sensors="real", threads=1)
    simulator = Simulator(make_scenario(scenario), worlds, config)
    simulator.reset(seed + np.arange(worlds))
    detector, parts = LegDetector(lidar, worlds, 1, forest), []
    rng = np.random.default_rng(seed)
    for step in range(120):
        frame = simulator.sense()
        if step % 10 == 9:
            out = detector.detect(frame.scan_m, simulator.robot_pose)
            people = simulator.people()
            for b in range(worlds):
                seen = rays_on_legs(simulator, b, frame.scan_m[b], lidar)
                here = people.active[b]
                n = out.count[b]
                others = people.pos_w[b][here & (seen < 3)].astype(float)
                shown = people.pos_w[b][here & (seen >= 3)].astype(float)
                parts.append(match(out.pos[b, :n].copy(), out.confidence[b, :n].copy(), shown, others))
        simulator.step(Command(np.full(worlds, 0.3), rng.uniform(-0.4, 0.4, worlds)))
    return pooled(parts)


def rays_on_legs(simulator: Simulator, b: int, scan_m: np.ndarray, lidar: LidarConfig) -> np.ndarray:
    """How many rays of a scan return from each person's legs, to 6 cm."""
    pose, angles = simulator.robot_pose[b], lidar.angles_rad
    hit = np.isfinite(scan_m)
    bearing = pose[2] + angles[hit]
    forward = np.array([np.cos(pose[2]), np.sin(pose[2])])
    points = pose[:2] + lidar.mount_x_m * forward + scan_m[hit, None] * np.stack([np.cos(bearing), np.sin(bearing)], 1)
    legs = simulator.body_cylinders(b)[:, [LEFT_LEG, RIGHT_LEG]]  # [P, 2, 5]
    off = np.hypot(*(points[:, None, None] - legs[None, :, :, :2]).transpose(3, 0, 1, 2)) - legs[None, :, :, 2]
    return ((off < 0.06).any(axis=2) & (legs[None, :, 0, 2] > 0)).sum(axis=0)


def on_recordings(data: Path, forest: Forest, report: bool = True) -> dict[str, Found]:
    """Positions in the real scans that nothing was trained on: those to report, or those to choose settings on.

    The empty rooms were recorded from a driving robot without its odometry, which the tracker needs: they judge
    positions in single scans, not tracks.
    """
    recordings = [one for one in labelled_legs(data) if one.name not in TRAINED_ON]
    tests = [recording for recording in recordings if (recording.name in CHOSEN_ON) != report]
    people = pooled([on_recording(recording, forest, everywhere=False) for recording in tests])
    rooms = [half_of(half_of(recording, first=False), first=not report) for recording in empty_rooms(data)]
    empty = pooled([on_recording(recording, forest, everywhere=True) for recording in rooms])
    outdoors = half_of(followed_person(data), first=not report)
    return {
        "real: people": people,
        "real: empty rooms": empty,
        "real: people and as many empty scans": pooled([people, _thinned(empty, people.scans)]),
        "real: followed outdoors": on_recording(outdoors, forest, everywhere=False),
    }


def evaluate_legs(data: Path | None, worlds: int = 16) -> dict[str, dict[str, dict[str, float]]]:
    """All tables: by test set, by detector (`forest`: ours, `rule`: by thumb), then the figures of `Found.summary`.
    Under `published (DROW)` what others report, on other data.

    Args:
        data: folder with `leg_tracker/` in it; without it, simulated scans alone.
    """
    tables: dict[str, dict[str, dict[str, float]]] = {}
    for name, forest in (("forest", shipped_forest()), ("rule", rule_of_thumb())):
        sets = {} if data is None else on_recordings(data, forest)
        for scenario in TESTS:
            sets[f"simulated: {scenario}"] = in_simulation(scenario, forest, worlds=worlds)
        for key, found in sets.items():
            tables.setdefault(key, {})[name] = found.summary()
    return tables | {"published (DROW)": PUBLISHED}


def _thinned(found: Found, scans: int) -> Found:
    """A set as if of fewer scans, by taking every so many of its positions."""
    keep = np.linspace(0, len(found.right) - 1, max(round(len(found.right) * scans / found.scans), 1)).astype(int)
    part = replace(found, confidence=found.confidence[keep], right=found.right[keep], error_m=found.error_m[keep])
    return replace(part, scans=scans)
