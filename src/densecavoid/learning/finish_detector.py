"""What follows the training of a detector: its threshold, how far to trust its places, and the files of the result."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
from scipy import optimize

from densecavoid.frames import CameraConfig
from densecavoid.learning.checkpoint import write_atomically
from densecavoid.perception.detector.card import DetectorCard, PlaceError
from densecavoid.perception.detector.detector import DepthDetector
from densecavoid.perception.detector.export import export_onnx, save_detector
from densecavoid.perception.detector.network import DarknetNetwork
from densecavoid.perception.detector.views import Views
from densecavoid.perception.evaluation.detector import (
    Found,
    curve,
    error_table,
    false_alarms_per_image,
    look_at,
    to_find,
)
from densecavoid.perception.truth_detector import MIN_VISIBLE_FRACTION

MOST_FALSE_PER_ROOM = 0.01
"""In images of training rooms without anybody: half of what is promised for new rooms."""
MAX_OVERLAP = 0.5
_LEAST_CONFIDENCE = 0.02
_FREEDOM = 4.0


def choose_threshold(views: Views, found: list[Found], in_rooms: list[Found]) -> float:
    """The confidence of the best F1 score for people 1.4 to 5 m away, or where false alarms in empty rooms end."""
    points = curve(views, found, to_find(views, (1.4, 5.0), (MIN_VISIBLE_FRACTION, np.inf)))
    score = 2 * points.precision * points.recall / np.maximum(points.precision + points.recall, 1e-9)
    best = float(points.confidence[int(np.argmax(score))])
    grid = np.arange(0.05, 0.96, 0.01)
    quiet = [t for t in grid.tolist() if false_alarms_per_image(in_rooms, t) <= MOST_FALSE_PER_ROOM]
    return float(round(max(best, min(quiet, default=0.95)), 2))


def fit_place_error(views: Views, detector: DepthDetector, threshold: float) -> PlaceError:
    """The coefficients under which the errors of those found are most likely, taken for Student's t.

    Errors have long tails, where a neighbour's depth is taken for a person's; with a Gaussian's likelihood those few
    would decide how far all others are trusted.
    """
    # With this as the whole error, the deviation claimed is what `hidden_m` is multiplied by.
    hidden_alone = PlaceError(floor_m=0.0, per_m2=0.0, unsure_m=0.0, hidden_m=1.0, cut_m=0.0)
    detector.card = dataclasses.replace(detector.card, place_error=hidden_alone)
    table = error_table(views, look_at(views, detector), threshold)
    counted = table["detected"] & (table["share"] >= MIN_VISIBLE_FRACTION)
    squared = (table["along_m"] ** 2 + table["across_m"] ** 2)[counted]
    terms = np.stack(
        [
            np.ones(len(squared)),
            table["distance_m"][counted] ** 2,
            1.0 - table["confidence"][counted],
            table["std_m"][counted],
            table["cut"][counted].astype(float),
        ]
    )

    def cost(logs: np.ndarray) -> float:
        variance = np.exp(2.0 * logs) @ terms**2
        # Of two dimensions with _FREEDOM degrees of freedom.
        tail = (_FREEDOM + 2.0) / 2.0 * np.log1p(squared / (_FREEDOM * variance))
        return float(np.mean(np.log(variance) + tail))

    default = PlaceError()
    start = np.log(np.maximum(dataclasses.astuple(default), 1e-4))
    best = optimize.minimize(cost, start, method="Nelder-Mead", options={"maxiter": 4000, "maxfev": 4000}).x
    return PlaceError(*(round(float(value), 5) for value in np.exp(best)))


def write_detector(
    out: Path, network: DarknetNetwork, text: str, camera: CameraConfig, views: Views, rooms: Views, training: dict
) -> DetectorCard:
    """Writes `detector.safetensors`, `detector.onnx` and `detector.json`, its card.

    Args:
        text: the network's configuration.
        camera: whose images it was trained on.
        views: images of training worlds that it was not trained on.
        rooms: the same, of rooms without anybody.
        training: where it comes from.
    """
    path = out / "detector.onnx"
    card = DetectorCard("depth-yolo", "depth", text, _LEAST_CONFIDENCE, MAX_OVERLAP, camera, PlaceError(), training)
    export_onnx(path, network, card)
    detector = DepthDetector(path)
    found, in_rooms = look_at(views, detector), look_at(rooms, detector)
    threshold = choose_threshold(views, found, in_rooms)
    everybody = to_find(views, (1.4, 5.0), (MIN_VISIBLE_FRACTION, math.inf))
    results = {
        "check_ap50": curve(views, found, everybody).average_precision,
        "check_false_per_empty_image": false_alarms_per_image(in_rooms, threshold),
    }
    card = dataclasses.replace(
        card,
        threshold=threshold,
        place_error=fit_place_error(views, detector, threshold),
        training=training | results,
    )
    save_detector(out / "detector.safetensors", network, card)
    export_onnx(path, network, card)
    write_atomically(out / "detector.json", (card.to_json() + "\n").encode())
    return card
