"""People found by their legs in lidar scans: those whom the camera can't see, and where exactly the others are.

Furniture has legs too: from one scan nobody can always tell them apart, and the tracker, which waits for legs to walk,
does the rest.
"""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from densecavoid.frames import LidarConfig, require
from densecavoid.networks.array_files import read_arrays
from densecavoid.perception.detections import Detections, allocate_detections
from densecavoid.perception.leg_segments import FEATURES, MAX_SEGMENTS, describe_scan
from densecavoid.sim._jit import for_worlds, inner, kernel, threads_for

WEIGHTS = Path(__file__).parent / "weights" / "legs.npz"
PAIR_M = 0.55
"""Centres of a person's legs are nearer to each other than this (95 % of walkers' within .45 m)."""
LEG_CONFIDENCE = 0.3
"""From which a segment counts as a leg."""

_MAX_BYTES = 4 << 20
_SHIN_M = 0.045  # a shin's axis lies so far behind the middle of what the scanner sees of it
_PAIR_STD_M, _SINGLE_STD_M, _STD_PER_M = 0.06, 0.12, 0.01
_BOTH_LEGS_M = 0.22  # a segment wider than this shows both
_MOST_CONFIDENCE = 0.95


class Forest(NamedTuple):
    """Boosted trees of one depth: each a complete binary tree, nodes in the order root, its children, theirs."""

    feature: np.ndarray  # i32 [trees, nodes] which to compare
    threshold: np.ndarray  # f64 [trees, nodes] up to this: to the left
    value: np.ndarray  # f64 [trees, leaves] log-odds to add
    base: float  # log-odds to begin with


def load_forest(path: Path) -> Forest:
    """A trained classifier of segments.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if it is none, or was made for other features.
    """
    names = tuple(str(name) for name in read_arrays(path, ["features"], _MAX_BYTES)["features"].ravel())
    require(names == FEATURES, f"features of {path.name}", names, str(FEATURES))
    parts = read_arrays(path, ["feature", "threshold", "value", "base"], _MAX_BYTES)
    for name, array in parts.items():
        require(array.dtype.kind in "iuf", f"{name} of {path.name}", str(array.dtype), "numbers")
        # A threshold may be infinite: a node that sends everything to one side.
        sound = not np.isnan(array).any() if name == "threshold" else np.isfinite(array).all()
        require(bool(sound), f"{name} of {path.name}", "not all finite", "finite")
    feature, threshold, value, base = parts.values()
    require(feature.ndim == 2 and feature.size > 0, f"shape of {path.name}'s trees", feature.shape, "(trees, nodes)")
    trees, nodes = feature.shape
    shapes = threshold.shape, value.shape, base.shape
    require(shapes == ((trees, nodes), (trees, nodes + 1), ()), f"shapes in {path.name}", shapes, "those of its trees")
    # The kernel looks these up without asking.
    known = feature.min() >= 0 and feature.max() < len(FEATURES)
    require(bool(known), f"features in {path.name}'s trees", feature.max(), f"0 to {len(FEATURES) - 1}")
    return Forest(feature.astype(np.int32), threshold.astype(np.float64), value.astype(np.float64), float(base))


@cache
def shipped_forest() -> Forest:
    """The classifier that comes with the package."""
    return load_forest(WEIGHTS)


@kernel
def leg_confidence(forest, features):
    """How surely a segment with these features is a leg, or two."""
    nodes, log_odds = forest.feature.shape[1], forest.base
    for tree in range(len(forest.feature)):
        node = 0
        while node < nodes:
            right = features[forest.feature[tree, node]] > forest.threshold[tree, node]
            node = 2 * node + 1 + right
        log_odds += forest.value[tree, node - nodes]
    return 1.0 / (1.0 + math.exp(-log_odds))


@inner
def _add_person(out, b, pose, mount_x, x, y, std_m, confidence):
    """Writes a person at x, y in the scanner's frame."""
    d = out.count[b]
    if d == out.pos.shape[1]:
        return
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    out.pos[b, d, 0] = pose[0] + cos * (x + mount_x) - sin * y
    out.pos[b, d, 1] = pose[1] + sin * (x + mount_x) + cos * y
    out.std_m[b, d] = std_m
    out.confidence[b, d] = min(confidence, _MOST_CONFIDENCE)
    out.body[b, d, 0] = out.body[b, d, 1] = np.nan
    out.count[b] = d + 1


@kernel
def _pair(legs, partner):
    """Pairs the legs of people: those nearest to each other first.

    Args:
        legs: [n, 4] x, y, width, confidence.
        partner: [n], written: the other leg, or -1.
    """
    n = len(legs)
    partner[:] = -1
    while True:
        best, left, right = PAIR_M * PAIR_M, -1, -1
        for i in range(n):
            if partner[i] >= 0 or legs[i, 2] > _BOTH_LEGS_M:
                continue
            for j in range(i + 1, n):
                if partner[j] >= 0 or legs[j, 2] > _BOTH_LEGS_M:
                    continue
                off_x, off_y = legs[i, 0] - legs[j, 0], legs[i, 1] - legs[j, 1]
                if off_x * off_x + off_y * off_y < best:
                    best, left, right = off_x * off_x + off_y * off_y, i, j
        if left < 0:
            return
        partner[left], partner[right] = right, left


@kernel
def _detect(first, last, which, scan, pose, cos, sin, increment, max_range, mount_x, forest, out):
    """Finds the people of each world."""
    num_rays = scan.shape[1]
    points, ranges = np.empty((num_rays, 2)), np.empty(num_rays)
    bounds, centres = np.empty((MAX_SEGMENTS, 3), np.int64), np.empty((MAX_SEGMENTS, 2))
    features = np.empty((MAX_SEGMENTS, len(FEATURES)))
    legs, partner = np.empty((MAX_SEGMENTS, 4)), np.empty(MAX_SEGMENTS, np.int64)
    for b in range(first, last):
        if not which[b]:
            continue
        out.count[b] = 0
        for r in range(num_rays):
            ranges[r] = scan[b, r]
        count = describe_scan(ranges, cos, sin, increment, max_range, points, bounds, centres, features)
        num_legs = 0
        for k in range(count):
            confidence = leg_confidence(forest, features[k])
            if confidence >= LEG_CONFIDENCE:
                away = 1.0 + _SHIN_M / features[k, 6]
                legs[num_legs, 0], legs[num_legs, 1] = away * centres[k, 0], away * centres[k, 1]
                legs[num_legs, 2], legs[num_legs, 3] = features[k, 0], confidence
                num_legs += 1
        _pair(legs[:num_legs], partner[:num_legs])
        for i in range(num_legs):
            far = _STD_PER_M * math.hypot(legs[i, 0], legs[i, 1])
            j = partner[i]
            if j > i:
                x, y = 0.5 * (legs[i, 0] + legs[j, 0]), 0.5 * (legs[i, 1] + legs[j, 1])
                sure = 1.0 - (1.0 - legs[i, 3]) * (1.0 - legs[j, 3])
                _add_person(out, b, pose[b], mount_x, x, y, _PAIR_STD_M + far, sure)
            elif j < 0:
                std = (_PAIR_STD_M if legs[i, 2] > _BOTH_LEGS_M else _SINGLE_STD_M) + far
                _add_person(out, b, pose[b], mount_x, legs[i, 0], legs[i, 1], std, legs[i, 3])


class LegDetector:
    """Finds people by their legs in the scans of one kind of lidar."""

    def __init__(self, lidar: LidarConfig, num_worlds: int = 1, threads: int = 0, forest: Forest | None = None) -> None:
        """
        Args:
            lidar: whose scans they are; it must be level, at the height of shins.
            num_worlds: B.
            threads: over the worlds; 0 takes all cores.
            forest: the classifier of segments; the shipped one unless given.
        """
        self.lidar, self.threads = lidar, threads
        self.forest = shipped_forest() if forest is None else forest
        angles = lidar.angles_rad
        self._geometry = np.cos(angles), np.sin(angles), float(angles[1] - angles[0])
        self._detections = allocate_detections(num_worlds)

    def detect(self, scan_m: np.ndarray, pose_odom: np.ndarray, which: np.ndarray | None = None) -> Detections:
        """People in the scans.

        Args:
            scan_m: f32 [B, rays]; what is not finite is no return.
            pose_odom: f64 [B, 3] of the robots in the odometry frame, as the scans were taken.
            which: bool [B] worlds to look at; all, if left out.

        Returns:
            Of those worlds, in arrays that the next call writes again. Bodies are NaN: legs tell nothing of them.

        Raises:
            ValueError: if the scans have another shape than announced.
        """
        num_worlds = len(self._detections.count)
        shape = (num_worlds, self.lidar.num_rays)
        require(scan_m.shape == shape, "scan_m", scan_m.shape, str(shape))
        which = np.ones(num_worlds, np.bool_) if which is None else which
        lidar = self.lidar
        for_worlds(
            _detect,
            num_worlds,
            threads_for(which, self.threads),
            which,
            scan_m,
            pose_odom,
            *self._geometry,
            float(lidar.max_range_m),
            float(lidar.mount_x_m),
            self.forest,
            self._detections,
        )
        return self._detections
