"""Measures a depth detector on held-out worlds: average precision, false alarms, errors of place, time.

`python -m densecavoid.perception.evaluation.detector` prints the results; `--errors FILE` writes what became of every
person, from which an error model is fitted.
"""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tyro

from densecavoid.frames import require
from densecavoid.perception.detections import Detections
from densecavoid.perception.detector.decode import Boxes
from densecavoid.perception.detector.detector import DepthDetector
from densecavoid.perception.detector.views import Views, ViewsConfig, take_views
from densecavoid.perception.detector.worlds import held_out_rooms, held_out_worlds
from densecavoid.perception.evaluation.average_precision import FALSE, PrecisionRecall, match, precision_recall
from densecavoid.perception.truth_detector import MIN_VISIBLE_FRACTION

LEAST_OVERLAP = 0.5
"""IoU from which a box has found a person."""
DISTANCE_BANDS_M = ((1.4, 2.0), (2.0, 3.0), (3.0, 4.0), (4.0, 5.0))
SHARE_BANDS = ((1 / 3, 0.5), (0.5, 0.75), (0.75, 1.01))
_LEAST_CONFIDENCE = 0.02
_FIRST_HELD_OUT_SEED = 1_000_000


@dataclass(frozen=True)
class DetectorEvaluation:
    """Settings of the measurement."""

    detector: str = "depth-yolo"
    """A shipped detector's name, or an ONNX file."""
    images: int = 3_000
    """In held-out worlds with people."""
    rooms: int = 1_500
    """Images of held-out rooms without people."""
    seed: int = 0
    vary_mount: bool = False
    """Cameras within 5 cm and 3 degrees of the mount they are meant for, up to 10 cm ahead; else all exactly there."""
    errors: Path | None = None
    """Where the table of every person's errors goes (npz)."""
    json: Path | None = None
    """Where the results go."""

    def __post_init__(self) -> None:
        for name in ("images", "rooms"):
            require(getattr(self, name) >= 1, f"DetectorEvaluation.{name}", getattr(self, name), "at least 1")
        require(self.seed >= 0, "DetectorEvaluation.seed", self.seed, "0 or more")


class Found(NamedTuple):
    """What a detector gives for one image: boxes, surest first, and where they stand relative to the robot."""

    boxes: Boxes
    place: Detections


def look_at(views: Views, detector: DepthDetector) -> list[Found]:
    """What a detector finds in each image, its camera mounted as the image's was."""
    found = []
    for depth, mount in zip(views.depth_m, views.mount.tolist(), strict=True):
        detector.mount(*mount)
        boxes = detector.find(depth)
        found.append(Found(boxes, detector.place(boxes, depth, np.zeros(3))))
    return found


def to_find(views: Views, distance_m: tuple[float, float], share: tuple[float, float]) -> np.ndarray:
    """bool [N, L]: people in a band of distance, of whom such a share is seen."""
    present = np.arange(views.share.shape[1]) < views.num_people[:, None]
    distance = np.hypot(views.place[..., 0], views.place[..., 1])
    far = (distance >= distance_m[0]) & (distance < distance_m[1])
    return present & far & (views.share >= share[0]) & (views.share < share[1])


def curve(views: Views, found: Sequence[Found], wanted: np.ndarray) -> PrecisionRecall:
    """Precision and recall for the wanted people; all others may be found or not."""
    confidence, kinds = [], []
    for n, (boxes, _) in enumerate(found):
        kind, _ = _match(views, n, boxes.box, wanted[n])
        confidence.append(boxes.confidence)
        kinds.append(kind)
    return precision_recall(np.concatenate(confidence), np.concatenate(kinds), int(wanted.sum()))


def _match(views: Views, n: int, boxes: np.ndarray, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    kind, partner = np.zeros(len(boxes), np.int64), np.zeros(len(boxes), np.int64)
    count = views.num_people[n]
    match(boxes, views.box[n, :count], wanted[:count], LEAST_OVERLAP, kind, partner)
    return kind, partner


def error_table(views: Views, found: Sequence[Found], threshold: float) -> dict[str, np.ndarray]:
    """What became of every person of whom anything is seen, and every false alarm, at an operating threshold.

    Returns:
        Arrays [P], one row a person: `image`, `distance_m` and `bearing_rad` from the robot's centre, `share` seen,
        `true_radius_m`, `true_height_m`, `detected`, and, NaN where not detected, `along_m` and `across_m` (errors of
        the place along the ray from the robot's centre, away from it, and to its left), `std_m`, `confidence`,
        `radius_m`, `height_m` (NaN too where the box does not tell; `cut`: because a side of the image cuts it).
        Arrays [F], one row a false alarm: `false_image`, `false_place_m` [F, 2] (ahead, left), `false_confidence`,
        `false_std_m`. And `num_images`.
    """
    wanted = to_find(views, (0.0, np.inf), (MIN_VISIBLE_FRACTION, np.inf))
    rows: list[tuple[float, ...]] = []
    false: list[tuple[float, ...]] = []
    for n, (boxes, place) in enumerate(found):
        sure = int((boxes.confidence[: place.count[0]] >= threshold).sum())
        kind, partner = _match(views, n, boxes.box[:sure], wanted[n])
        who = {int(j): i for i, j in enumerate(partner) if j >= 0}
        for j in range(views.num_people[n]):
            x, y = views.place[n, j].tolist()
            distance, bearing = float(np.hypot(x, y)), float(np.arctan2(y, x))
            result = (np.nan,) * 6
            if j in who:
                i = who[j]
                off_x, off_y = (place.pos[0, i] - (x, y)).tolist()
                ahead, left = x / distance, y / distance
                along, across = off_x * ahead + off_y * left, off_y * ahead - off_x * left
                result = (along, across, place.std_m[0, i], place.confidence[0, i], *place.body[0, i].tolist())
            rows.append((n, distance, bearing, views.share[n, j], *views.body[n, j].tolist(), j in who, *result))
        for i in np.flatnonzero(kind == FALSE):
            false.append((n, *place.pos[0, i].tolist(), place.confidence[0, i], place.std_m[0, i]))
    names = ("image", "distance_m", "bearing_rad", "share", "true_radius_m", "true_height_m", "detected")
    names = (*names, "along_m", "across_m", "std_m", "confidence", "radius_m", "height_m")
    columns = np.array(rows, np.float64).reshape(-1, len(names)).T
    table: dict[str, np.ndarray] = dict(zip(names, columns, strict=True))
    table["detected"] = table["detected"] > 0
    table["cut"] = table["detected"] & np.isnan(table["radius_m"])
    wrong = np.array(false, np.float64).reshape(-1, 5)
    return table | {
        "false_image": wrong[:, 0],
        "false_place_m": wrong[:, 1:3],
        "false_confidence": wrong[:, 3],
        "false_std_m": wrong[:, 4],
        "num_images": np.array(len(found)),
    }


def false_alarms_per_image(found: Sequence[Found], threshold: float) -> float:
    """In images without anybody."""
    return float(np.mean([(boxes.confidence >= threshold).sum() for boxes, _ in found]))


def evaluate_detector(config: DetectorEvaluation) -> dict[str, Any]:
    """All results, as plain values: `ap50` (people at 1.4 to 5 m of whom a third or more is seen) and by bands,
    `false_per_empty_image`, `recall` and `precision` at the operating threshold, errors of place, `ms_per_image`.

    Raises:
        FileNotFoundError: if there is no such detector.
        ValueError: if the file is no detector for depth images.
    """
    detector = DepthDetector(config.detector, threshold=_LEAST_CONFIDENCE)
    threshold = detector.card.threshold
    looking = ViewsConfig(camera=detector.camera, vary_mount=config.vary_mount)
    seed = _FIRST_HELD_OUT_SEED + config.seed
    views = take_views(held_out_worlds(), config.images, seed, looking)
    rooms = take_views(held_out_rooms(), config.rooms, seed, looking)
    found, in_rooms = look_at(views, detector), look_at(rooms, detector)
    table = error_table(views, found, threshold)
    if config.errors is not None:
        alone = error_table(rooms, in_rooms, threshold)
        empty = {f"empty_{name}": value for name, value in alone.items() if name.startswith(("false", "num"))}
        np.savez(config.errors, **table, **empty)  # pyright: ignore[reportArgumentType]
    near_far, seen = (1.4, 5.0), (MIN_VISIBLE_FRACTION, np.inf)
    overall = curve(views, found, to_find(views, near_far, seen))
    sure = overall.confidence >= threshold
    return {
        "detector": config.detector,
        "sha256": detector.sha256,
        "threshold": threshold,
        "images": len(found),
        "people_to_find": int(to_find(views, near_far, seen).sum()),
        "ap50": overall.average_precision,
        "ap50_by_distance": {
            f"{a}-{b} m": curve(views, found, to_find(views, (a, b), seen)).average_precision
            for a, b in DISTANCE_BANDS_M
        },
        "ap50_by_share_seen": {
            f"{a:.2f}-{min(b, 1.0):.2f}": curve(views, found, to_find(views, near_far, (a, b))).average_precision
            for a, b in SHARE_BANDS
        },
        "recall": float(overall.recall[sure][-1]) if sure.any() else 0.0,
        "precision": float(overall.precision[sure][-1]) if sure.any() else float("nan"),
        "empty_images": len(in_rooms),
        "false_per_empty_image": false_alarms_per_image(in_rooms, threshold),
        "false_per_crowd_image": len(table["false_image"]) / len(found),
        "place": place_errors(table),
        "ms_per_image": time_detector(config.detector, views),
    }


def place_errors(table: dict[str, np.ndarray]) -> dict[str, Any]:
    """Errors of place of those found at 1.4 to 5 m of whom a third or more is seen, m; and how true the claims are."""
    counted = table["detected"] & (table["share"] >= MIN_VISIBLE_FRACTION)
    counted &= (table["distance_m"] >= 1.4) & (table["distance_m"] < 5.0)
    rows = {name: table[name][counted] for name in ("distance_m", "share", "along_m", "across_m", "std_m")}
    error = np.hypot(rows["along_m"], rows["across_m"])
    within = error**2 < -2.0 * np.log(0.5) * rows["std_m"] ** 2  # the 50 % ellipse of a round Gaussian
    bands = {f"{a}-{b} m": (rows["distance_m"] >= a) & (rows["distance_m"] < b) for a, b in DISTANCE_BANDS_M}
    bands |= {f"{a:.2f}-{min(b, 1.0):.2f} seen": (rows["share"] >= a) & (rows["share"] < b) for a, b in SHARE_BANDS}
    return {
        "median_m": float(np.median(error)),
        "90th_percentile_m": float(np.percentile(error, 90)),
        "median_along_m": float(np.median(np.abs(rows["along_m"]))),
        "median_across_m": float(np.median(np.abs(rows["across_m"]))),
        "bias_along_m": float(np.median(rows["along_m"])),
        "inside_claimed_half": float(within.mean()),
        "by_band": {
            name: {"median_m": float(np.median(error[band])), "inside_claimed_half": float(within[band].mean())}
            for name, band in bands.items()
            if band.any()
        },
    }


def time_detector(name_or_path: str, views: Views, repeats: int = 300) -> dict[str, float]:
    """Median milliseconds of finding alone, and of finding and placing, on one thread."""
    detector = DepthDetector(name_or_path)
    images = views.depth_m[: min(repeats, len(views.num_people))]
    times = np.empty((len(images), 2))
    for n, image in enumerate(images):
        begin = time.perf_counter()
        detector.find(image)
        middle = time.perf_counter()
        detector.detect(image)
        times[n] = middle - begin, time.perf_counter() - middle
    return {"find": float(np.median(times[:, 0]) * 1e3), "detect": float(np.median(times[:, 1]) * 1e3)}


def main(args: Sequence[str] | None = None) -> None:
    """Prints the results as JSON."""
    config = tyro.cli(DetectorEvaluation, prog="python -m densecavoid.perception.evaluation.detector", args=args)
    results = evaluate_detector(config)
    text = json.dumps(results, indent=1)
    print(text)
    if config.json is not None:
        config.json.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
