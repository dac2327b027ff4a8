"""Trains the classifier of legs: segments of simulated scans, which know what they are of, and of real ones.

Boosted trees from scikit-learn, written down as plain arrays, so that detecting needs nothing of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from densecavoid.frames import CameraConfig, Command, LidarConfig, require
from densecavoid.perception.leg_recordings import empty_rooms, half_of, labelled_legs
from densecavoid.perception.leg_segments import FEATURES, MAX_SEGMENTS, describe_scan
from densecavoid.perception.legs import WEIGHTS, Forest
from densecavoid.scenarios import make_scenario
from densecavoid.sim.people import LEFT_LEG, RIGHT_LEG
from densecavoid.sim.world import SimConfig, Simulator

SCENARIOS = ("cluttered-static", "random-pedestrians", "dense-random-pedestrians", "lobby", "plaza", "doorway")
"""Of training and everyday life; the tests' worlds stay unknown."""
LIDARS = (LidarConfig(), LidarConfig(num_rays=768, fov_rad=np.radians(269.6), max_range_m=11.0, min_range_m=0.03))
"""The paper's, and the scanner of the recordings."""
TRAINED_ON = ("positive_1_extracted", "positive_2_extracted")
"""Recordings to train on, beside the first half of the empty rooms."""
CHOSEN_ON = ("positive_3_extracted",)
"""Recordings to choose settings on, beside the third quarter of the empty rooms and the first half of the person
followed outdoors. The rest is for the report alone: of trees, depth and weights the shipped ones were best here."""
_NEAR_LEG_M = 0.06


@dataclass(frozen=True)
class LegTrainingConfig:
    """Settings of `densecavoid perceive train-legs`."""

    data: Path | None = None
    """Folder with `leg_tracker/` in it; without it, simulated scans alone are learnt from."""
    out: Path = WEIGHTS
    """File for the classifier."""
    trees: int = 48
    depth: int = 4
    worlds: int = 24
    """Simulated of each scenario and lidar."""
    looks: int = 8
    """Scans of each, 1 s apart."""
    real_weight: tuple[float, float] = (5.0, 2.0)
    """How much a real leg counts, and another real segment; a simulated one counts 1."""
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("trees", "depth", "worlds", "looks"):
            require(getattr(self, name) >= 1, f"LegTrainingConfig.{name}", getattr(self, name), "at least 1")


def segments(
    scan_m: Float[np.ndarray, "rays"], lidar: LidarConfig
) -> tuple[Float[np.ndarray, "n features"], list[Float[np.ndarray, "_ 2"]]]:
    """Features of a scan's segments, and the returns of each in the scanner's frame (the middle ray along x)."""
    angles = lidar.angles_rad
    points, bounds = np.empty((len(angles), 2)), np.empty((MAX_SEGMENTS, 3), np.int64)
    centres, features = np.empty((MAX_SEGMENTS, 2)), np.empty((MAX_SEGMENTS, len(FEATURES)))
    shape = np.cos(angles), np.sin(angles), float(angles[1] - angles[0]), float(lidar.max_range_m)
    count = describe_scan(scan_m.astype(np.float64), *shape, points, bounds, centres, features)
    cut = [points[first : last + 1] for first, last, _ in bounds[:count]]
    return features[:count], [part[np.isfinite(part[:, 0])] for part in cut]


def simulated_segments(
    scenario: str, lidar: LidarConfig, worlds: int, looks: int, seed: int
) -> tuple[Float[np.ndarray, "n features"], Bool[np.ndarray, "n"]]:
    """Segments of `real` scans of simulated worlds, and which are legs. What is partly so is left out."""
    made = make_scenario(scenario)
    if hasattr(made, "level"):
        made = type(made)(level=0.8)  # type: ignore[call-arg]
    config = SimConfig(lidar=lidar, camera=CameraConfig(width=4, height=4), sensors="real")
    simulator = Simulator(made, worlds, config)
    rng = np.random.default_rng(seed)
    simulator.reset(rng.integers(0, 2**31, worlds))
    features, are_legs = [], []
    for _ in range(looks):
        for _ in range(10):
            frame = simulator.sense()
            simulator.step(Command(rng.uniform(0, 0.3, worlds), rng.uniform(-0.4, 0.4, worlds)))
        frame = simulator.sense()
        for b in range(worlds):
            pose = simulator.robot_pose[b]
            parts = simulator.body_cylinders(b)[:, [LEFT_LEG, RIGHT_LEG]].reshape(-1, 5)
            parts = parts[parts[:, 2] > 0]
            for row, points in zip(*segments(frame.scan_m[b], lidar), strict=True):
                x = pose[0] + np.cos(pose[2]) * points[:, 0] - np.sin(pose[2]) * points[:, 1]
                y = pose[1] + np.sin(pose[2]) * points[:, 0] + np.cos(pose[2]) * points[:, 1]
                off = np.hypot(x[:, None] - parts[:, 0], y[:, None] - parts[:, 1]) - parts[:, 2]
                share = (off < _NEAR_LEG_M).any(axis=1).mean()
                if share > 0.7 or share < 0.1:
                    features.append(row)
                    are_legs.append(share > 0.7)
    return np.array(features).reshape(-1, len(FEATURES)), np.array(are_legs, bool)


def real_segments(data: Path) -> tuple[Float[np.ndarray, "n features"], Bool[np.ndarray, "n"]]:
    """Segments of the recordings to train on: labelled legs, and everything in the empty rooms."""
    features, are_legs = [], []
    for recording in labelled_legs(data):
        if recording.name in TRAINED_ON:
            for scan, labels in zip(recording.scans_m, recording.labels, strict=True):
                turn = np.array([np.cos(-recording.yaw_rad), np.sin(-recording.yaw_rad)])
                x, y = labels[:, 0], labels[:, 1]
                labels_here = np.stack([turn[0] * x - turn[1] * y, turn[1] * x + turn[0] * y], axis=1)
                for row, points in zip(*segments(scan, recording.lidar), strict=True):
                    if np.hypot(*(labels_here - points.mean(axis=0)).T).min(initial=np.inf) < 0.1:
                        features.append(row)
                        are_legs.append(True)
    for recording in empty_rooms(data):
        for scan in half_of(recording, first=True).scans_m[::2]:
            rows, _ = segments(scan, recording.lidar)
            features.extend(rows)
            are_legs.extend([False] * len(rows))
    return np.array(features).reshape(-1, len(FEATURES)), np.array(are_legs, bool)


def fit_forest(
    features: Float[np.ndarray, "n features"],
    are_legs: Bool[np.ndarray, "n"],
    weight: Float[np.ndarray, "n"],
    trees: int,
    depth: int,
    seed: int,
) -> Forest:
    """Boosted trees that tell legs from other segments.

    Raises:
        ValueError: if scikit-learn is not there.
    """
    try:
        from sklearn.ensemble import GradientBoostingClassifier
    except ModuleNotFoundError:
        raise ValueError("training on legs needs scikit-learn: pip install 'densecavoid[train]'") from None
    boosted = GradientBoostingClassifier(
        n_estimators=trees, max_depth=depth, learning_rate=0.25, subsample=0.7, min_samples_leaf=20, random_state=seed
    )
    boosted.fit(features, are_legs, sample_weight=weight)
    share = np.average(are_legs, weights=weight)
    nodes, leaves = 2**depth - 1, 2**depth
    feature, threshold = np.zeros((trees, nodes), np.int32), np.full((trees, nodes), np.inf)
    value = np.zeros((trees, leaves))

    def write(tree, node: int, place: int, k: int) -> None:
        """A node at its place among the complete tree's; a leaf higher up stands for all leaves below it."""
        inner = tree.children_left[node] >= 0
        if place >= nodes:
            value[k, place - nodes] = boosted.learning_rate * tree.value[node, 0, 0]
            return
        if inner:
            feature[k, place], threshold[k, place] = tree.feature[node], tree.threshold[node]
        write(tree, int(tree.children_left[node]) if inner else node, 2 * place + 1, k)
        write(tree, int(tree.children_right[node]) if inner else node, 2 * place + 2, k)

    for k in range(trees):
        write(boosted.estimators_[k, 0].tree_, 0, 0, k)
    return Forest(feature, threshold, value, float(np.log(share / (1.0 - share))))


def save_forest(forest: Forest, path: Path) -> None:
    """Writes the classifier to a file that `legs.load_forest` reads."""
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(
        path,
        features=np.array(FEATURES),
        feature=forest.feature.astype(np.int8),
        threshold=forest.threshold.astype(np.float32),
        value=forest.value.astype(np.float32),
        base=np.float64(forest.base),
    )


def train_legs(config: LegTrainingConfig) -> Forest:
    """Trains the classifier and writes it to `config.out`."""
    features, are_legs, weight = [], [], []
    for number, scenario in enumerate(SCENARIOS):
        for lidar in LIDARS:
            rows, legs = simulated_segments(scenario, lidar, config.worlds, config.looks, config.seed + number)
            features.append(rows)
            are_legs.append(legs)
            weight.append(np.ones(len(rows)))
            print(f"{scenario}, {lidar.num_rays} rays: {len(rows)} segments, {legs.sum()} of legs", flush=True)
    if config.data is not None:
        rows, legs = real_segments(config.data)
        features.append(rows)
        are_legs.append(legs)
        weight.append(np.where(legs, *config.real_weight))
        print(f"recordings: {len(rows)} segments, {legs.sum()} of legs", flush=True)
    columns = np.concatenate(features), np.concatenate(are_legs), np.concatenate(weight)
    forest = fit_forest(*columns, config.trees, config.depth, config.seed)
    save_forest(forest, config.out)
    return forest
