"""A detector's errors without the detector: people's true places in, what the detector would have found out.

Training meets hundreds of worlds, for which a network on every image is too slow. The model is fitted to the real
detector (`evaluation.error_fit`): how often somebody is missed, how far off they are placed, and what is seen where
nobody is.

All randomness is a hash of (the episode's key, the step, the person): the same bits for any number of threads and
worlds.
"""

from __future__ import annotations

import itertools
import json
import math
from dataclasses import asdict, dataclass, fields
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from densecavoid.frames import require
from densecavoid.perception.detections import MAX_DETECTIONS
from densecavoid.perception.projection import MIN_DEPTH_M, body_box, from_camera
from densecavoid.perception.truth_detector import visible_fraction
from densecavoid.sim._jit import inner, kernel
from densecavoid.sim.noise import hash_of, normal_of, share_of

GHOSTS = 2
"""False alarms of one world at once."""
QUANTILES = 17
"""Of an error's distribution, from 1/34 to 33/34."""
FOUND, ALONG_MEAN, ALONG_STD, ACROSS_STD, CLAIMED_STD, CONFIDENCE, RADIUS_STD, HEIGHT_STD = range(8)
TABLES = (
    "found",
    "along_mean_m",
    "along_std_m",
    "across_std_m",
    "claimed_std_m",
    "confidence",
    "radius_std_m",
    "height_std_m",
)
_MISS, _ALONG, _ACROSS, _BODY, _GHOST = range(5)  # one stream of random numbers each
_CUT_PX = 1.0  # a body that ends so near the image's edge, or beyond it, has a width and a height that nobody can tell
_ATTEMPTS = 4  # pixels that are tried until one shows a surface
_SHIPPED = "depth-yolo-errors.json"


@dataclass(frozen=True)
class DetectorErrors:
    """What is fitted. Tables have a row for each `visible` and a column for each `distance_m`; between them they are
    interpolated. Along is along the ray from the camera, away from it; across is to its left."""

    visible: tuple[float, ...]
    """Shares of a trunk that the camera shows (`truth_detector.visible_fraction`), ascending."""
    distance_m: tuple[float, ...]
    """Ascending."""
    found: tuple[tuple[float, ...], ...]
    """Share of people who are detected."""
    along_mean_m: tuple[tuple[float, ...], ...]
    along_std_m: tuple[tuple[float, ...], ...]
    across_std_m: tuple[tuple[float, ...], ...]
    claimed_std_m: tuple[tuple[float, ...], ...]
    """What the detector takes for its standard deviation."""
    confidence: tuple[tuple[float, ...], ...]
    """Its mean."""
    radius_std_m: tuple[tuple[float, ...], ...]
    height_std_m: tuple[tuple[float, ...], ...]
    along_shape: tuple[float, ...]
    """Quantiles of the standardised errors: how heavy their tails are."""
    across_shape: tuple[float, ...]
    lasting: tuple[float, float, float]
    """Of misses, of errors along and across: the share of the variance that does not change from image to image."""
    lasts_s: tuple[float, float, float]
    """Seconds between two independent values of that share."""
    ghosts_per_image: float
    """False alarms; they stand at surfaces that the camera sees."""
    ghost_lasts_s: float
    ghost_confidence: float
    source: str = ""
    """Which detector, and from how many images."""

    def __post_init__(self) -> None:
        for name in ("visible", "distance_m"):
            nodes = getattr(self, name)
            ascending = len(nodes) >= 2 and all(a < b for a, b in itertools.pairwise(nodes))
            require(ascending, f"DetectorErrors.{name}", nodes, "two or more ascending numbers")
        shape = (len(self.visible), len(self.distance_m))
        for name in TABLES:
            table = np.array(getattr(self, name), float)
            fits = table.shape == shape and bool(np.isfinite(table).all())
            require(fits, f"DetectorErrors.{name}", table.shape, f"finite numbers, {shape[0]} rows of {shape[1]}")
        for name in ("found", "confidence"):
            table = np.array(getattr(self, name))
            require(bool(((table >= 0) & (table <= 1)).all()), f"DetectorErrors.{name}", table, "from 0 to 1")
        for name in ("along_shape", "across_shape"):
            require(len(getattr(self, name)) == QUANTILES, f"DetectorErrors.{name}", getattr(self, name), "17 numbers")
        within = all(0 <= share <= 1 for share in self.lasting) and all(time > 0 for time in self.lasts_s)
        require(within, "DetectorErrors.lasting, lasts_s", (self.lasting, self.lasts_s), "shares, and times above 0")
        require(0 <= self.ghosts_per_image < 1, "DetectorErrors.ghosts_per_image", self.ghosts_per_image, "in [0, 1)")
        require(self.ghost_lasts_s > 0, "DetectorErrors.ghost_lasts_s", self.ghost_lasts_s, "above 0 s")

    def save(self, path: Path) -> None:
        """Writes JSON, a line a table's row."""
        lines = [f' "{name}": {_rows(value)}' for name, value in asdict(self).items()]
        path.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


def _rows(value: Any) -> str:
    if isinstance(value, tuple) and value and isinstance(value[0], tuple):
        return "[\n  " + ",\n  ".join(json.dumps(row) for row in value) + "\n ]"
    return json.dumps(value)


def load_errors(path: Path | None = None) -> DetectorErrors:
    """The errors in a file, or those of the shipped detector.

    Raises:
        ValueError: for a file that holds something else, naming what is wrong.
    """
    if path is None:
        text = (resources.files("densecavoid.perception") / "weights" / _SHIPPED).read_text(encoding="utf-8")
    else:
        text = path.read_text(encoding="utf-8")
    try:
        values = json.loads(text)
        known = {field.name for field in fields(DetectorErrors)}
        require(isinstance(values, dict) and set(values) <= known, "keys of the file", list(values), str(sorted(known)))
        return DetectorErrors(**{name: _tuples(value) for name, value in values.items()})
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path or _SHIPPED} does not describe a detector's errors: {error}") from error


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


class ErrorTables(NamedTuple):
    """`DetectorErrors` as the kernel reads it."""

    visible: np.ndarray  # f64 [V]
    distance: np.ndarray  # f64 [D]
    table: np.ndarray  # f64 [8, V, D]: TABLES
    shape: np.ndarray  # f64 [2, QUANTILES] along, across
    lasting: np.ndarray  # f64 [3] of misses, along, across
    lasts_s: np.ndarray  # f64 [3]
    ghost_rate: float
    ghost_lasts_s: float
    ghost_confidence: float


def error_tables(errors: DetectorErrors) -> ErrorTables:
    """The same as arrays."""
    return ErrorTables(
        np.array(errors.visible),
        np.array(errors.distance_m),
        np.array([getattr(errors, name) for name in TABLES]),
        np.array([errors.along_shape, errors.across_shape]),
        np.array(errors.lasting),
        np.array(errors.lasts_s),
        float(errors.ghosts_per_image),
        float(errors.ghost_lasts_s),
        float(errors.ghost_confidence),
    )


@inner
def node_below(nodes, value):
    """The node at or below a value (never the last), and how far on the way to the next it is, in [0, 1]."""
    k = 0
    while k < nodes.shape[0] - 2 and nodes[k + 1] <= value:
        k += 1
    return k, min(max((value - nodes[k]) / (nodes[k + 1] - nodes[k]), 0.0), 1.0)


@inner
def _between(table, row, down, column, right):
    """A table's value between four nodes."""
    upper = (1.0 - right) * table[row, column] + right * table[row, column + 1]
    lower = (1.0 - right) * table[row + 1, column] + right * table[row + 1, column + 1]
    return (1.0 - down) * upper + down * lower


@inner
def _latent(key, person, stream, step, dt, lasting, lasts_s):
    """A standard Gaussian of a person at a step: part of it is new at each step, part lasts.

    The part that lasts runs in straight lines between independent values that are `lasts_s` apart. It needs no memory.
    """
    mine = hash_of(hash_of(key, person), stream)
    now = step * dt / lasts_s + share_of(mine)
    before = math.floor(now)
    after = now - before
    slow = (1.0 - after) * normal_of(hash_of(mine, 2 * before)) + after * normal_of(hash_of(mine, 2 * before + 2))
    slow /= math.sqrt((1.0 - after) ** 2 + after**2)
    return math.sqrt(lasting) * slow + math.sqrt(1.0 - lasting) * normal_of(hash_of(mine, 2 * step + 1))


@inner
def _share_below(gaussian):
    return 0.5 * math.erfc(-0.7071067811865476 * gaussian)


@inner
def _shaped(shape, gaussian):
    """The value of the distribution with quantiles `shape` that is as far out as a standard Gaussian's `gaussian`."""
    place = _share_below(gaussian) * QUANTILES - 0.5
    k = min(max(math.floor(place), 0), QUANTILES - 2)
    return shape[k] + (place - k) * (shape[k + 1] - shape[k])  # beyond the last quantile the line goes on


@inner
def _write(out, b, x, y, std, radius, height, confidence):
    d = out.count[b]
    if d < MAX_DETECTIONS:
        out.pos[b, d, 0], out.pos[b, d, 1], out.std_m[b, d] = x, y, std
        out.body[b, d, 0], out.body[b, d, 1] = radius, height
        out.confidence[b, d] = confidence
        out.count[b] += 1


@inner
def _see_ghosts(image, b, odom, key, step, dt, tables, view, ghosts, out):
    """False alarms of one world: some last, some are new, at the surface in a pixel in the middle half of its rows."""
    for g in range(GHOSTS):
        mine = hash_of(hash_of(hash_of(key, -1 - g), _GHOST), step)
        last = math.exp(-dt / tables.ghost_lasts_s)
        if ghosts[b, g, 2] > 0.0 and share_of(mine) > last:
            ghosts[b, g, 2] = 0.0
        elif ghosts[b, g, 2] == 0.0 and share_of(hash_of(mine, 1)) < tables.ghost_rate / GHOSTS * (1.0 - last):
            for attempt in range(_ATTEMPTS):
                u = int(share_of(hash_of(mine, 2 + 2 * attempt)) * view.width)
                v = int((0.25 + 0.5 * share_of(hash_of(mine, 3 + 2 * attempt))) * view.rows)
                depth = image[v, u]
                if depth > 0.0 and ghosts[b, g, 2] == 0.0:  # NaN is not
                    ahead = view.ahead_m + depth * view.cos_pitch
                    left = (0.5 * view.width - u - 0.5) / view.focal_x * depth
                    cos, sin = math.cos(odom[2]), math.sin(odom[2])
                    ghosts[b, g, 0] = odom[0] + cos * ahead - sin * left
                    ghosts[b, g, 1] = odom[1] + sin * ahead + cos * left
                    ghosts[b, g, 2] = 1.0
        if ghosts[b, g, 2] > 0.0:
            std = tables.table[CLAIMED_STD, -1, -1]
            _write(out, b, ghosts[b, g, 0], ghosts[b, g, 1], std, np.nan, np.nan, tables.ghost_confidence)


@kernel
def find_with_errors(
    first, last, which, depth, true_pose, odom_pose, people, keys, step, dt, tables, view, ghosts, out
):
    """Writes what a detector with the errors of `tables` would find in each marked world into `out` (`Detections`).

    Args:
        depth: [B, height, width] what the camera shows, m: who is hidden in it is missed.
        true_pose, odom_pose: [B, 3] the robot in the world, and where it believes to be.
        people: a `frames.People`.
        keys, step: u64 [B], i64 [B]: of the episode, and control steps since its start.
        dt: seconds a step.
        ghosts: f64 [B, GHOSTS, 3] memory of false alarms: x, y in the odometry frame, whether there is one.
    """
    for b in range(first, last):
        if not which[b]:
            continue
        out.count[b] = 0
        odom = odom_pose[b]
        cos, sin = math.cos(odom[2]), math.sin(odom[2])
        for i in range(people.pos_w.shape[1]):
            if not people.active[b, i]:
                continue
            forward, left = from_camera(view, true_pose[b], people.pos_w[b, i, 0], people.pos_w[b, i, 1])
            radius, height, person = people.radius_m[b, i], people.height_m[b, i], people.id[b, i]
            if forward < MIN_DEPTH_M:
                continue
            seen = visible_fraction(depth[b], forward, left, radius, height, view)
            if seen <= 0.0:
                continue
            distance = math.sqrt(forward * forward + left * left)
            row, down = node_below(tables.visible, seen)
            column, right = node_below(tables.distance, distance)
            miss = _latent(keys[b], person, _MISS, step[b], dt, tables.lasting[0], tables.lasts_s[0])
            if _share_below(miss) >= _between(tables.table[FOUND], row, down, column, right):
                continue
            along = _latent(keys[b], person, _ALONG, step[b], dt, tables.lasting[1], tables.lasts_s[1])
            along = _shaped(tables.shape[0], along) * _between(tables.table[ALONG_STD], row, down, column, right)
            along += _between(tables.table[ALONG_MEAN], row, down, column, right)
            across = _latent(keys[b], person, _ACROSS, step[b], dt, tables.lasting[2], tables.lasts_s[2])
            across = _shaped(tables.shape[1], across) * _between(tables.table[ACROSS_STD], row, down, column, right)
            ahead = view.ahead_m + forward + (forward * along - left * across) / distance
            aside = left + (left * along + forward * across) / distance
            body = hash_of(hash_of(hash_of(keys[b], person), _BODY), step[b])
            u_min, v_min, u_max, _ = body_box(forward, left, radius, height, view)
            wide = radius + _between(tables.table[RADIUS_STD], row, down, column, right) * normal_of(body)
            high = height + _between(tables.table[HEIGHT_STD], row, down, column, right) * normal_of(hash_of(body, 1))
            _write(
                out,
                b,
                odom[0] + cos * ahead - sin * aside,
                odom[1] + sin * ahead + cos * aside,
                _between(tables.table[CLAIMED_STD], row, down, column, right),
                max(wide, 0.1) if u_min >= _CUT_PX and u_max <= view.width - _CUT_PX else np.nan,
                max(high, 0.5) if v_min >= _CUT_PX else np.nan,
                _between(tables.table[CONFIDENCE], row, down, column, right),
            )
        _see_ghosts(depth[b], b, odom, keys[b], step[b], dt, tables, view, ghosts, out)
