"""All of perception measured: what `densecavoid perceive evaluate` prints, writes and draws."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from densecavoid.frames import Navigator, require
from densecavoid.perception.config import PerceptionConfig
from densecavoid.perception.evaluation.detector import DetectorEvaluation, evaluate_detector
from densecavoid.perception.evaluation.error_fit import ErrorTable, record_errors
from densecavoid.perception.evaluation.forms import FormsComparison, compare_forms
from densecavoid.perception.evaluation.frame import FrameEvaluation, evaluate_frames, frame_table
from densecavoid.perception.evaluation.legs import evaluate_legs
from densecavoid.perception.evaluation.predictor import (
    evaluate_predictors,
    hermes_test_windows,
    robot_predictors,
    tables,
)
from densecavoid.perception.evaluation.predictor_picture import draw_prediction_sheet
from densecavoid.perception.evaluation.tracker import TrackingRun, evaluate_tracker
from densecavoid.perception.pipeline import PeoplePipeline
from densecavoid.perception.projection import camera_view
from densecavoid.perception.sources import ImageSource
from densecavoid.scenarios.recordings import resolve_data
from densecavoid.sim.world import SimConfig, Simulator

PICTURED = ("dense-ped", "corridor-15", "random-sparse-ped")


@dataclass(frozen=True)
class EvaluateConfig:
    """Settings of `densecavoid perceive evaluate`."""

    out: Path = Path("perception-results")
    """Folder of the pictures."""
    json: Path | None = None
    """Where all figures go."""
    data: Path | None = None
    """Folder of the recordings (ETH/UCY, HERMES, leg scans); what needs them is left out where there are none."""
    detector: str = "depth-yolo"
    """A shipped detector's name, or an ONNX file."""
    images: int = 3_000
    """For the detector, in held-out worlds, and half as many of empty rooms."""
    steps: int = 150
    """Control steps of each world, for tracks, frames and forms."""
    worlds: int = 8
    """Of each scenario."""
    seed: int = 0
    threads: int = 0

    def __post_init__(self) -> None:
        for name in ("images", "steps", "worlds"):
            require(getattr(self, name) >= 2, f"EvaluateConfig.{name}", getattr(self, name), "at least 2")


_FILE_WIDTH = 200
"""Columns of a file or a pipe, which tell of no width of their own: no table is cut."""


def evaluate(config: EvaluateConfig, navigator: Navigator, console: Console | None = None) -> dict[str, Any]:
    """Measures everything, prints a table after each part, and draws.

    Args:
        config: how much.
        navigator: drives the robots among whom the tracker follows people.
        console: where tables go; the terminal, unless given.

    Returns:
        `detector.ap50`, `.false_per_empty_image` and more; `tracker.mota`, `.idf1`, ...; `legs`; `predictor.eth_ucy`,
        `.hermes`, `.tracked` by name; `frame.iou_0.1`, ... of the default predictor and `frame.by_predictor`; `forms`.
    """
    console = console or Console()
    if not console.is_terminal:
        console.width = max(console.width, _FILE_WIDTH)
    config.out.mkdir(parents=True, exist_ok=True)
    data = _recordings(config.data)
    results: dict[str, Any] = {}

    def keep(name: str, part: dict[str, Any], *shown: Table) -> None:
        results[name] = part
        for table in shown:
            console.print(table)
        if config.json is not None:  # what there is survives a stop
            config.json.write_text(json.dumps(results, indent=1, default=float) + "\n", encoding="utf-8")

    looking = DetectorEvaluation(config.detector, config.images, config.images // 2, config.seed)
    detector = evaluate_detector(looking)
    keep("detector", detector, _rows("Detector, held-out worlds", {"": _numbers(detector)}))
    run = TrackingRun(config.worlds, config.steps, 20_000 + config.seed)
    followed = evaluate_tracker(navigator, ImageSource(run.sim.camera, config.worlds, config.detector), run=run)
    keep("tracker", {**followed["all"], "by_scenario": followed}, _rows("Tracker, the network's detections", followed))
    legs = evaluate_legs(data)
    keep("legs", legs, *(_rows(f"Legs, {name}", part) for name, part in legs.items()))
    if data is not None:
        predictors = evaluate_predictors(data)
        keep("predictor", predictors, *tables(predictors))
        draw_prediction_sheet(config.out / "predictions.png", hermes_test_windows(data), predictors)
    else:
        console.print("Predictors: skipped, there are no recordings (--data FOLDER)")
    frames = FrameEvaluation(worlds=config.worlds, steps=config.steps, seed=config.seed, threads=config.threads)
    by_predictor = frame_table(evaluate_frames(robot_predictors(), frames), frames.horizons_s)
    default = by_predictor[PerceptionConfig().predictor]
    keep(
        "frame",
        {**default, "by_predictor": by_predictor},
        _rows("Prediction frame, IoU with the truth's", by_predictor),
    )
    comparison = FormsComparison(worlds=config.worlds, steps=config.steps, seed=config.seed, threads=config.threads)
    forms = {form: scores.summary() for form, scores in compare_forms(comparison).items()}
    keep("forms", forms, _rows("Two forms on the same episodes (truth: exact places)", forms))
    for path in draw(config):
        console.print(str(path))
    return results


def _recordings(given: Path | None) -> Path | None:
    try:
        return resolve_data(given)
    except ValueError:  # none are given
        return None


def draw(config: EvaluateConfig) -> list[Path]:
    """Writes the pictures: detections on images, tracks and predictions from above, errors by distance and density."""
    # Imported here so that measuring needs no pictures' libraries.
    from densecavoid.viz.detections import SheetConfig, write_sheet
    from densecavoid.viz.perception import errors_by_distance, tracks_from_above

    paths = [config.out / name for name in ("detections.png", "tracks.png", "errors.png")]
    write_sheet(SheetConfig(paths[0], config.detector))
    perception = PerceptionConfig(people_from="detector", horizons_s=(0.4, 1.2), threads=1)
    tracks_from_above(paths[1], PeoplePipeline(perception, 1), PICTURED)
    errors_by_distance(paths[2], held_out_errors(config))
    return paths


def held_out_errors(config: EvaluateConfig) -> ErrorTable:
    """What the detector finds and misses in the benchmark's crowds."""
    from densecavoid.perception.detector.worlds import held_out_worlds

    sim = Simulator(held_out_worlds(), config.worlds, SimConfig(sensors="real", threads=config.threads))
    source, everybody = ImageSource(sim.config.camera, config.worlds, config.detector), np.ones(config.worlds, np.bool_)
    steps = -(-config.images // config.worlds)
    view = camera_view(sim.config.camera)
    return record_errors(
        sim, lambda moment: source.find(moment.frame, everybody), view, steps, 30_000_000 + config.seed
    )


def _numbers(part: Mapping[str, Any]) -> dict[str, float]:
    """The plain numbers of a result, those one level down by `name.name`."""
    found: dict[str, float] = {}
    for name, value in part.items():
        if isinstance(value, float | int):
            found[name] = float(value)
        elif isinstance(value, Mapping):
            inner = {f"{name}.{key}": float(v) for key, v in value.items() if isinstance(v, float | int)}
            found |= inner
    return found


def _rows(title: str, rows: Mapping[str, Mapping[str, float]]) -> Table:
    """One column a row, for there are more figures than names."""
    table = Table(title=title)
    table.add_column("")
    for name in rows:
        table.add_column(name, justify="right")
    for figure in next(iter(rows.values()), {}):
        table.add_row(figure, *(f"{row.get(figure, float('nan')):.3f}" for row in rows.values()))
    return table
