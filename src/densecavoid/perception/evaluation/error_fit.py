"""Fits the error model to a real detector: what it found in simulated images, beside who was there.

`record_errors` drives robots about in crowds and writes down every person and every false alarm; `fit_errors` turns
that into a `DetectorErrors`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import linear_sum_assignment
from scipy.special import ndtr, ndtri

from densecavoid.frames import People, SensorFrame, require, seen_from
from densecavoid.perception.config import PerceptionConfig
from densecavoid.perception.detections import Detections
from densecavoid.perception.error_model import QUANTILES, DetectorErrors
from densecavoid.perception.evaluation.driving import Moment, drive_about
from densecavoid.perception.projection import CameraView, camera_view
from densecavoid.perception.sources import ImageSource
from densecavoid.perception.truth_detector import visible_people
from densecavoid.sim.world import SimConfig, Simulator

VISIBLE = (0.05, 0.15, 0.33, 0.6, 0.95)
DISTANCE_M = (1.2, 1.6, 2.2, 3.0, 4.0, 5.0)
MATCHED_M = 0.5
"""A detection farther from everybody is a false alarm."""
_AROUND_M = 2.0
_LAGS = (1, 2, 4, 8, 16)
_PRIOR = 20.0  # people that the next coarser table counts for
_LEAST_STD_M = 0.01
Find = Callable[[Moment], Detections]


@dataclass(frozen=True)
class ErrorFit:
    """Settings of `densecavoid perceive fit-error-model`."""

    out: Path = Path("errors.json")
    """Where the model goes."""
    detector: str = "depth-yolo"
    """A shipped detector's name, or an ONNX file."""
    images: int = 24_000
    """In worlds as the detector was trained in, drawn anew."""
    worlds: int = 32
    """At once."""
    seed: int = 20_000_000
    threads: int = 0

    def __post_init__(self) -> None:
        for name in ("images", "worlds"):
            require(getattr(self, name) >= 1, f"ErrorFit.{name}", getattr(self, name), "at least 1")
        require(self.seed >= 0, "ErrorFit.seed", self.seed, "0 or more")


def fit_detector_errors(config: ErrorFit) -> DetectorErrors:
    """Watches a detector at work and writes the model of its errors.

    Raises:
        FileNotFoundError: if there is no such detector.
        ValueError: if it finds too few people for a model.
    """
    from densecavoid.perception.detector.worlds import training_worlds

    simulator = Simulator(training_worlds(), config.worlds, SimConfig(sensors="real", threads=config.threads))
    perception = PerceptionConfig(simulator.config.lidar, simulator.config.camera, people_from="detector")
    source = ImageSource(perception.camera, config.worlds, config.detector)
    everybody = np.ones(config.worlds, np.bool_)
    steps = -(-config.images // config.worlds)
    table = record_errors(
        simulator,
        lambda moment: source.find(moment.frame, everybody),
        camera_view(perception.camera),
        steps,
        config.seed,
    )
    name = f"{Path(config.detector).name}, {table.images} images, {len(table.person)} sightings"
    errors = fit_errors(table, simulator.config.control_dt_s, name)
    errors.save(config.out)
    return errors


class ErrorTable(NamedTuple):
    """N sightings of people, each a row, and what was seen where nobody was."""

    person: Int[np.ndarray, "N"]
    """Another number for each person in each episode."""
    step: Int[np.ndarray, "N"]
    visible: Float[np.ndarray, "N"]
    distance_m: Float[np.ndarray, "N"]
    density: Float[np.ndarray, "N"]
    """People per m2 within 2 m of the person."""
    found: Bool[np.ndarray, "N"]
    error: Float[np.ndarray, "N 4"]
    """Metres along and across the ray, of the radius and of the height; NaN where not found or not told."""
    claimed: Float[np.ndarray, "N 2"]
    """Standard deviation in m, and confidence."""
    ghost: Float[np.ndarray, "G 4"]
    """World, step, x and y of each false alarm."""
    ghost_confidence: Float[np.ndarray, "G"]
    images: int


def match_people(found: np.ndarray, there: np.ndarray, farthest_m: float) -> Iterator[tuple[int, int]]:
    """Pairs (row of `found`, row of `there`) of places [N, 2] with the least total distance, within `farthest_m`."""
    if len(found) and len(there):
        distance = np.hypot(*(found[:, None] - there[None]).transpose(2, 0, 1))
        for d, i in zip(*linear_sum_assignment(np.minimum(distance, farthest_m)), strict=True):
            if distance[d, i] < farthest_m:
                yield int(d), int(i)


def record_errors(simulator: Simulator, find: Find, view: CameraView, steps: int, seed: int = 0) -> ErrorTable:
    """Drives the simulator's robots about at random and compares what `find` finds with who is there.

    Args:
        simulator: any number of worlds.
        find: gives the detections of a moment in the odometry frame.
        view: the simulator's camera.
        steps: control steps of each world.
        seed: of worlds and commands.
    """
    rows: list[tuple[float, ...]] = []
    ghosts: list[tuple[float, ...]] = []
    for step, moment in enumerate(drive_about(simulator, steps, seed)):
        frame, detections = moment.frame, find(moment)
        truth = frame.truth
        assert truth is not None
        for b in range(simulator.num_worlds):
            people = _people_ahead(truth.people, frame, b, view, truth.robot_pose_w[b])
            count = int(detections.count[b])
            found = seen_from(frame.odom_pose[b], detections.pos[b, :count])
            pairs = {i: d for d, i in match_people(found, people[:, :2], MATCHED_M)}
            for i, person in enumerate(people):
                who = float(moment.episode[b] * 10_000 + person[5])
                error, claimed = _compare(found, detections, b, pairs.get(i), person)
                rows.append((who, step, person[4], math.hypot(*person[:2]), person[6], i in pairs, *error, *claimed))
            for d in set(range(count)) - set(pairs.values()):
                ghosts.append((b, step, *detections.pos[b, d], detections.confidence[b, d]))
    table, ghost = np.array(rows).reshape(-1, 12), np.array(ghosts).reshape(-1, 5)
    return ErrorTable(
        person=table[:, 0].astype(np.int64),
        step=table[:, 1].astype(np.int64),
        visible=table[:, 2],
        distance_m=table[:, 3],
        density=table[:, 4],
        found=table[:, 5].astype(bool),
        error=table[:, 6:10],
        claimed=table[:, 10:12],
        ghost=ghost[:, :4],
        ghost_confidence=ghost[:, 4],
        images=steps * simulator.num_worlds,
    )


def _people_ahead(people: People, frame: SensorFrame, b: int, view: CameraView, pose: np.ndarray) -> np.ndarray:
    """Everybody in world b of whom the camera shows something: forward and left of the robot, radius, height, share
    visible, id, people per m2 around."""
    shares = visible_people(frame.depth_m[b], pose, people, b, view)
    seen = shares > 0.0
    places = seen_from(pose, people.pos_w[b, seen].astype(float))
    everybody = seen_from(pose, people.pos_w[b, people.active[b]].astype(float))
    near = np.hypot(*(places[:, None] - everybody[None]).transpose(2, 0, 1)) < _AROUND_M
    density = near.sum(axis=1) / (math.pi * _AROUND_M**2)
    rest = people.radius_m[b, seen], people.height_m[b, seen], shares[seen], people.id[b, seen], density
    return np.column_stack([places, *rest])


def _compare(
    found: np.ndarray, detections: Detections, b: int, d: int | None, person: np.ndarray
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    if d is None:
        return (math.nan,) * 4, (math.nan,) * 2
    off, ray = found[d] - person[:2], person[:2] / math.hypot(*person[:2])
    body = detections.body[b, d] - person[2:4]
    error = float(off @ ray), float(off[1] * ray[0] - off[0] * ray[1]), float(body[0]), float(body[1])
    return error, (float(detections.std_m[b, d]), float(detections.confidence[b, d]))


def fit_errors(table: ErrorTable, period_s: float, source: str = "") -> DetectorErrors:
    """The error model of a table whose steps are `period_s` apart.

    Raises:
        ValueError: if there are fewer than 1,000 sightings: the model would be made of chance.
    """
    require(int(table.found.sum()) >= 1000, "sightings", int(table.found.sum()), "1,000 or more people found")
    weights = _node_weights(table)
    found = table.found
    near = weights[found]

    def spread(values: np.ndarray) -> np.ndarray:
        known = np.isfinite(values)
        return np.maximum(np.sqrt(_node_means(near[known], values[known] ** 2)), _LEAST_STD_M)

    along, across, radius, height = table.error[found].T
    along_mean = _node_means(near, along)
    centred = along - _at_nodes(near, along_mean)
    along_std, across_std = spread(centred), spread(across)
    scaled = centred / _at_nodes(near, along_std), across / _at_nodes(near, across_std)
    share = (np.arange(QUANTILES) + 0.5) / QUANTILES
    shapes = [tuple(np.quantile(values, share).round(4).tolist()) for values in scaled]
    chance = _node_means(weights, found.astype(float))
    correlations = [_miss_correlations(table, np.clip(_at_nodes(weights, chance), 1e-3, 1 - 1e-3))]
    correlations += [_correlations(table.person[found], table.step[found], _normal_scores(v)) for v in scaled]
    lasting = [_fit_lasting(correlation, period_s) for correlation in correlations]
    ghosts = len(table.ghost)
    return DetectorErrors(
        visible=VISIBLE,
        distance_m=DISTANCE_M,
        found=_as_rows(chance),
        along_mean_m=_as_rows(along_mean),
        along_std_m=_as_rows(along_std),
        across_std_m=_as_rows(across_std),
        claimed_std_m=_as_rows(_node_means(near, table.claimed[found, 0])),
        confidence=_as_rows(_node_means(near, table.claimed[found, 1])),
        radius_std_m=_as_rows(spread(radius)),
        height_std_m=_as_rows(spread(height)),
        along_shape=shapes[0],
        across_shape=shapes[1],
        lasting=tuple(round(share, 3) for share, _ in lasting),  # type: ignore[arg-type]
        lasts_s=tuple(round(time_s, 3) for _, time_s in lasting),  # type: ignore[arg-type]
        ghosts_per_image=round(min(ghosts / table.images, 0.99), 5),
        ghost_lasts_s=round(_ghost_lasts_s(table, period_s), 3),
        ghost_confidence=round(float(table.ghost_confidence.mean()), 3) if ghosts else 0.5,
        source=source,
    )


def _as_rows(table: np.ndarray) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(round(float(value), 4) for value in row) for row in table)


def _axis_weights(nodes: tuple[float, ...], values: np.ndarray) -> np.ndarray:
    """[N, nodes] weights of linear interpolation; beyond the ends the last node's alone."""
    return np.stack([np.interp(values, nodes, row) for row in np.eye(len(nodes))], axis=1)


def _node_weights(table: ErrorTable) -> np.ndarray:
    """[N, visible, distance] weights with which the model will read its tables for each sighting."""
    return _axis_weights(VISIBLE, table.visible)[:, :, None] * _axis_weights(DISTANCE_M, table.distance_m)[:, None, :]


def _node_means(weights: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Means around each node; where there are few values, those of all distances, and then of all, count too."""
    if len(values) == 0:
        return np.zeros(weights.shape[1:])
    total, count = np.einsum("nvd,n->vd", weights, values), weights.sum(axis=0)
    overall = values.mean()
    rows = (total.sum(axis=1) + _PRIOR * overall) / (count.sum(axis=1) + _PRIOR)
    return (total + _PRIOR * rows[:, None]) / (count + _PRIOR)


def _at_nodes(weights: np.ndarray, table: np.ndarray) -> np.ndarray:
    return np.einsum("nvd,vd->n", weights, table)


def _normal_scores(values: np.ndarray) -> np.ndarray:
    """Each value's rank as a standard Gaussian's."""
    rank = np.empty(len(values))
    rank[np.argsort(values)] = np.arange(len(values))
    return ndtri((rank + 0.5) / len(values))


def _pairs(person: np.ndarray, step: np.ndarray, lag: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows of the same person `lag` steps apart."""
    code = person * 1_000_000 + step
    order = np.argsort(code)
    place = np.searchsorted(code[order], code + lag)
    place = np.minimum(place, len(code) - 1)
    there = code[order][place] == code + lag
    return np.flatnonzero(there), order[place[there]]


def _correlations(person: np.ndarray, step: np.ndarray, score: np.ndarray) -> np.ndarray:
    """[lags, 2] correlation of the same person's scores, and of how many pairs."""
    rows = []
    for lag in _LAGS:
        first, second = _pairs(person, step, lag)
        rows.append((float(np.mean(score[first] * score[second])) if len(first) else 0.0, len(first)))
    return np.array(rows)


def _miss_correlations(table: ErrorTable, chance: np.ndarray) -> np.ndarray:
    """The same of the Gaussians behind misses: those for which as many pairs would be missed twice as are."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(24)
    weights = weights / weights.sum()
    rows = []
    for lag in _LAGS:
        first, second = _pairs(table.person, table.step, lag)
        missed = float(np.mean(~table.found[first] & ~table.found[second])) if len(first) else 0.0
        low, high = 0.0, 0.999
        for _ in range(12 if len(first) else 0):
            middle = 0.5 * (low + high)
            both = np.ones((len(first), len(nodes)))
            for rows_of in (first, second):
                bound = ndtri(1.0 - chance[rows_of])[:, None]
                both *= ndtr((bound - math.sqrt(middle) * nodes) / math.sqrt(1.0 - middle))
            low, high = (middle, high) if float(np.mean(both @ weights)) < missed else (low, middle)
        rows.append((0.5 * (low + high) if len(first) else 0.0, len(first)))
    return np.array(rows)


def lasting_correlation(lag: Float[np.ndarray, "L"]) -> Float[np.ndarray, "L"]:
    """Correlation of the model's lasting part with itself, `lag` (in its own time) later, averaged over phases."""
    phase = (np.arange(64) + 0.5) / 64
    then = phase[None] + np.asarray(lag, float)[:, None]
    knot = np.floor(then)
    after = then - knot

    def weights(at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        norm = np.sqrt((1 - at) ** 2 + at**2)
        return (1 - at) / norm, at / norm

    (a0, a1), (b0, b1) = weights(phase), weights(after)
    same = np.where(knot == 0, a0 * b0 + a1 * b1, np.where(knot == 1, a1 * b0, 0.0))
    return same.mean(axis=1)


def _fit_lasting(correlations: np.ndarray, period_s: float) -> tuple[float, float]:
    """The share and the time that describe correlations at `_LAGS` best."""
    wanted, count = correlations.T
    best = (math.inf, 0.0, 1.0)
    for time_s in np.geomspace(period_s, 60 * period_s, 40):
        curve = lasting_correlation(np.array(_LAGS) * period_s / time_s)
        norm = float(np.sum(count * curve**2))
        share = min(max(float(np.sum(count * curve * wanted)) / norm, 0.0), 1.0) if norm > 0 else 0.0
        best = min(best, (float(np.sum(count * (share * curve - wanted) ** 2)), share, float(time_s)))
    return best[1], best[2]


def _ghost_lasts_s(table: ErrorTable, period_s: float) -> float:
    """Mean time that a false alarm lasts, from the share of them that is there again a step later."""
    again, ghost = 0, table.ghost
    for world, step, x, y in ghost:
        later = ghost[(ghost[:, 0] == world) & (ghost[:, 1] == step + 1)]
        again += bool((np.hypot(later[:, 2] - x, later[:, 3] - y) < 0.5).any())
    share = min(max(again / max(len(ghost), 1), 0.05), 0.95)
    return -period_s / math.log(share)
