"""A picture of prediction: a crowd from above, where people went and were expected, and errors by time and density."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int

from densecavoid.perception.evaluation.predictor import DENSITIES, REQUIRED_DENSITIES, robot_predictors
from densecavoid.perception.predictor.calibration import INSIDE_HALF
from densecavoid.perception.predictor.contract import ROBOT_HORIZONS_S, Predictor
from densecavoid.perception.predictor.windows import Windows

_COLOURS = {
    "constant-velocity": "#7b8794",
    "constant-velocity over 1 s": "#b5b9c0",
    "kalman": "#2563eb",
    "kalman (.4 s)": "#93bef6",
    "robust-tp": "#168754",
    "compact": "#e8590c",
}
_INK, _PERSON, _EXPECTED = "#1f2933", "#f08a4b", "#2563eb"
_EXAMPLES = ("constant-velocity", "robust-tp", "compact")


def draw_prediction_sheet(path: Path, windows: Windows, results: dict[str, Any]) -> None:
    """Writes the PNG.

    Args:
        path: its folder is made.
        windows: of HERMES test runs; the most crowded instant below 1.5 people per m2 is drawn.
        results: what `evaluate_predictors` returned.
    """
    from matplotlib import pyplot as plt

    predictors = robot_predictors()
    shown = [name for name in _EXAMPLES if name in predictors]
    figure = plt.figure(figsize=(15.0, 3.9 * len(shown) + 4.6), layout="constrained")
    grid = figure.add_gridspec(len(shown) + 1, 3, height_ratios=[0.9] * len(shown) + [1.0])
    rows = _busiest(windows)
    for number, name in enumerate(shown):
        axis = figure.add_subplot(grid[number, :])
        _draw_crowd(axis, windows, rows, predictors[name])
        axis.set_title(f"{name}: 1.2 s ahead, 50 % ellipses", fontsize=10, color=_INK)
    recorded, tracked, density = (figure.add_subplot(grid[-1, column]) for column in range(3))
    low, high = REQUIRED_DENSITIES
    _draw_errors(recorded, results["hermes"], f"HERMES two-way, {low:g} to {high:g} people per m2")
    _draw_errors(tracked, results["tracked"], "the same from tracks with a tracker's errors")
    _draw_densities(density, results["hermes"])
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _busiest(windows: Windows) -> Int[np.ndarray, "M"]:
    """Rows of the instant with the most people whose density is within what is required."""
    low, high = REQUIRED_DENSITIES
    inside = (windows.density >= low) & (windows.density < high)
    groups, counts = np.unique(windows.group[inside], return_counts=True)
    return np.flatnonzero(windows.group == groups[np.argmax(counts)])


def _draw_crowd(axis: Any, windows: Windows, rows: Int[np.ndarray, "M"], predictor: Predictor) -> None:
    people = windows.subset(rows)
    prediction = predictor.predict(people.histories(), ROBOT_HORIZONS_S)
    angle = np.linspace(0.0, 2.0 * np.pi, 40)
    circle = np.sqrt(INSIDE_HALF) * np.stack([np.cos(angle), np.sin(angle)])
    for n in range(len(people)):
        past = people.pos[n, people.valid[n]]
        axis.plot(past[:, 1], past[:, 0], color=_PERSON, lw=1.2, alpha=0.5)
        axis.plot(past[-1, 1], past[-1, 0], "o", color=_PERSON, ms=7)
        truth = np.concatenate([past[-1:], people.future[n]])
        axis.plot(truth[:, 1], truth[:, 0], ":", color=_INK, lw=1.0)
        axis.plot(truth[-1, 1], truth[-1, 0], "x", color=_INK, ms=5)
        xx, xy, yy = prediction.covariance[n, -1]
        root = np.linalg.cholesky(np.array([[xx, xy], [xy, yy]]))
        ring = prediction.mean[n, -1][:, None] + root @ circle
        axis.plot(ring[1], ring[0], color=_EXPECTED, lw=1.2)
        way = np.concatenate([past[-1:], prediction.mean[n]])
        axis.plot(way[:, 1], way[:, 0], color=_EXPECTED, lw=1.2)
    axis.set_aspect("equal")
    axis.set_xlabel("along the corridor, m   (dots: now, crosses: 1.2 s later, blue: expected)", fontsize=8)
    axis.set_ylabel("across, m", fontsize=8)


def _draw_errors(axis: Any, table: dict[str, Any], title: str) -> None:
    for name, row in table.items():
        axis.plot(
            ROBOT_HORIZONS_S, [row[f"error_{h:g}"] for h in ROBOT_HORIZONS_S], "o-", color=_COLOURS[name], label=name
        )
    axis.set_title(title, fontsize=10, color=_INK)
    axis.set_xlabel("time ahead, s", fontsize=8)
    axis.set_ylabel("mean error, m", fontsize=8)
    axis.set_ylim(bottom=0)
    axis.grid(alpha=0.3)
    axis.legend(fontsize=8)


def _draw_densities(axis: Any, table: dict[str, Any]) -> None:
    middle = [0.5 * (a + b) for a, b in itertools.pairwise(DENSITIES)]
    for name, row in table.items():
        axis.plot(middle, list(row["by_density"].values()), "o-", color=_COLOURS[name], label=name)
    axis.set_title("1.2 s ahead, by density", fontsize=10, color=_INK)
    axis.set_xlabel("people per m2", fontsize=8)
    axis.set_ylabel("mean error, m", fontsize=8)
    axis.set_ylim(bottom=0)
    axis.grid(alpha=0.3)
