"""Tables of prediction (BENCHMARK, Prediction): ETH/UCY as the field measures it, HERMES two-way runs by density,
tracks with a tracker's errors, and whether the predicted Gaussians are as wide as the errors.
"""

from __future__ import annotations

import itertools
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from rich.table import Table

from densecavoid.perception.predictor.calibration import inside_half, negative_log_likelihood
from densecavoid.perception.predictor.constant_velocity import ConstantVelocity
from densecavoid.perception.predictor.contract import (
    FIELD_PERIOD_S,
    FIELD_PREDICTED,
    ROBOT_HORIZONS_S,
    ROBOT_PERIOD_S,
    ROBOT_SAMPLES,
    Histories,
    Prediction,
    Predictor,
)
from densecavoid.perception.predictor.kalman import KalmanPredictor
from densecavoid.perception.predictor.learned import LEARNED, LearnedPredictor, every
from densecavoid.perception.predictor.registry import PREDICTORS, make_predictor
from densecavoid.perception.predictor.track_noise import TrackNoise, as_tracked
from densecavoid.perception.predictor.windows import HERMES_TEST, SCENES, Windows, eth_ucy_test, hermes, join

DENSITIES = (0.5, 0.75, 1.0, 1.25, 1.5, 2.0)
"""People per m2 between the columns of the tables."""
REQUIRED_DENSITIES = (0.5, 1.5)
_HERMES_STRIDE = 4  # windows every .4 s
_NOISE_SEED = 0


class Thinned:
    """A predictor that is shown every fourth place: .4 s steps, as the field has them."""

    def __init__(self, predictor: Predictor) -> None:
        self.predictor, self.name = predictor, f"{predictor.name} (.4 s)"

    def predict(self, histories: Histories, horizons_s: Sequence[float]) -> Prediction:
        """As `Predictor.predict`."""
        return self.predictor.predict(every(histories, FIELD_PERIOD_S), horizons_s)


def robot_predictors() -> dict[str, Predictor]:
    """Those of the registry whose weights are there, and the strongest settings of the two that learn nothing."""
    found: dict[str, Predictor] = {}
    for name in PREDICTORS:
        if name in ("constant-velocity", "kalman") or f"predictor-{name}-robot" in LEARNED.names():
            found[name] = make_predictor(name)
    found["constant-velocity over 1 s"] = ConstantVelocity(over_s=1.0)
    found["kalman (.4 s)"] = Thinned(KalmanPredictor())
    return found


def evaluate_predictors(data: Path, folds: Path | None = None) -> dict[str, Any]:
    """All tables as one dictionary, for JSON.

    Args:
        data: folder of the recordings.
        folds: folder of the weights that `train-predictor --task field --fold SCENE` wrote; None: those shipped.

    Returns:
        `eth_ucy.<name>.ade1`, `.fde1`, `.ade3`, ... `.fde12` (m, the mean over scenes, and `.scenes.<scene>`);
        `hermes.<name>.fde3` (m, 1.2 s ahead, .5 to 1.5 people per m2), `.ade3`, `.by_density`, `.error_<horizon>`,
        `.inside_50_<horizon>`, `.nll_<horizon>`; `tracked.<name>`: the same from tracks with a tracker's errors;
        `time.<name>`: microseconds a track for 10 tracks in each of 100 worlds, ms for 15 people.
    """
    windows = hermes_test_windows(data)
    tracked = as_tracked(windows, TrackNoise(), np.random.default_rng(_NOISE_SEED))
    predictors = robot_predictors()
    return {
        "eth_ucy": eth_ucy_table(data, folds),
        "hermes": {name: robot_row(predictor, windows) for name, predictor in predictors.items()},
        "tracked": {name: robot_row(predictor, tracked) for name, predictor in predictors.items()},
        "time": {name: timing(predictor) for name, predictor in predictors.items()},
    }


def hermes_test_windows(data: Path) -> Windows:
    """People between the walls of the runs that no predictor was trained on; heads as recorded, .1 s steps."""
    ahead = [round(horizon / ROBOT_PERIOD_S) for horizon in ROBOT_HORIZONS_S]
    return join(
        [
            hermes(data, run, ROBOT_PERIOD_S, ROBOT_SAMPLES, ahead, stride=_HERMES_STRIDE, inside=True)
            for run in HERMES_TEST
        ]
    )


def robot_row(predictor: Predictor, windows: Windows) -> dict[str, Any]:
    """Errors, calibration and likelihood at the robot's horizons."""
    prediction = predictor.predict(windows.histories(), ROBOT_HORIZONS_S)
    error = np.linalg.norm(prediction.mean - windows.future, axis=2)
    low, high = REQUIRED_DENSITIES
    required = _between(windows.density, low, high)
    chosen = Prediction(prediction.mean[required], prediction.covariance[required])
    inside = inside_half(chosen, windows.future[required])
    likelihood = negative_log_likelihood(chosen, windows.future[required])
    row: dict[str, Any] = {
        "people": int(required.sum()),
        "fde3": _mean(error[required, -1]),
        "ade3": _mean(error[required, 1:]),
        "by_density": {
            f"{a:g}-{b:g}": _mean(error[_between(windows.density, a, b), -1]) for a, b in itertools.pairwise(DENSITIES)
        },
    }
    for column, horizon in enumerate(ROBOT_HORIZONS_S):
        row[f"error_{horizon:g}"] = _mean(error[required, column])
        row[f"inside_50_{horizon:g}"] = round(float(inside[column]), 4)
        row[f"nll_{horizon:g}"] = _mean(likelihood[:, column])
    return row


def eth_ucy_table(data: Path, folds: Path | None = None) -> dict[str, Any]:
    """ADE and FDE (m) at 1, 3 and 12 steps of .4 s, leave one scene out, for all predictors that have all folds."""
    makers: dict[str, Callable[[str], Predictor]] = {
        "constant-velocity": lambda scene: ConstantVelocity(),
        "kalman": lambda scene: KalmanPredictor(),
    }
    for kind in ("robust-tp", "compact"):
        if all(_fold(kind, scene, folds) is not None for scene in SCENES):
            makers[kind] = lambda scene, kind=kind: LearnedPredictor(_fold(kind, scene, folds) or "")
    table: dict[str, Any] = {name: {"scenes": {}} for name in makers}
    horizons = FIELD_PERIOD_S * np.arange(1, FIELD_PREDICTED + 1)
    for scene in SCENES:
        windows = eth_ucy_test(data, scene)
        for name, make in makers.items():
            prediction = make(scene).predict(windows.histories(), horizons.tolist())
            error = np.linalg.norm(prediction.mean - windows.future, axis=2)
            row: dict[str, Any] = {"people": len(windows)}
            for steps in (1, 3, 12):
                row[f"ade{steps}"] = _mean(error[:, :steps])
                row[f"fde{steps}"] = _mean(error[:, steps - 1])
            row["inside_50"] = round(float(inside_half(prediction, windows.future).mean()), 4)
            table[name]["scenes"][scene] = row
    for name in makers:
        rows = table[name]["scenes"].values()
        for figure in ("ade1", "fde1", "ade3", "fde3", "ade12", "fde12", "inside_50"):
            table[name][figure] = round(float(np.mean([row[figure] for row in rows])), 4)
    return table


def timing(predictor: Predictor, repeats: int = 21) -> dict[str, float]:
    """Medians on this machine, one thread."""
    rng = np.random.default_rng(0)

    def crowd(worlds: int, people: int) -> Histories:
        walks = np.cumsum(rng.normal(0.0, 0.1, (worlds * people, ROBOT_SAMPLES, 2)), axis=1)
        walks += rng.uniform(-4.0, 4.0, (worlds * people, 1, 2))
        group = np.repeat(np.arange(worlds), people)
        return Histories(walks, np.ones(walks.shape[:2], np.bool_), group, walks[:, -1] - walks[:, -2], ROBOT_PERIOD_S)

    figures = {}
    for name, histories, unit in (("us_a_track", crowd(100, 10), 1e6 / 1000), ("ms_for_15", crowd(1, 15), 1e3)):
        predictor.predict(histories, ROBOT_HORIZONS_S)
        took_s = []
        for _ in range(repeats):
            started_s = time.perf_counter()
            predictor.predict(histories, ROBOT_HORIZONS_S)
            took_s.append(time.perf_counter() - started_s)
        figures[name] = round(statistics.median(took_s) * unit, 3)
    return figures


def tables(results: Mapping[str, Any]) -> list[Table]:
    """What `evaluate_predictors` returned, to print."""
    field = Table(title="ETH/UCY, leave one scene out: ADE/FDE at 12 steps of .4 s, m")
    for column in ("", *SCENES, "average", "3 steps", "1 step"):
        field.add_column(column, justify="left" if not column else "right")
    for name, row in results["eth_ucy"].items():
        cells = [f"{row['scenes'][scene]['ade12']:.3f}/{row['scenes'][scene]['fde12']:.3f}" for scene in SCENES]
        means = [f"{row[f'ade{steps}']:.3f}/{row[f'fde{steps}']:.3f}" for steps in (12, 3, 1)]
        field.add_row(name, *cells, *means)
    return [
        field,
        _robot_table("HERMES two-way, heads as recorded", results["hermes"]),
        _robot_table("HERMES two-way, tracks with a tracker's errors", results["tracked"]),
        _time_table(results["time"]),
    ]


def _robot_table(title: str, rows: Mapping[str, Any]) -> Table:
    low, high = REQUIRED_DENSITIES
    table = Table(title=f"{title}: error, m, and truths inside the 50 % ellipse, at {low:g} to {high:g} people per m2")
    bands = [f"{a:g}-{b:g}" for a, b in itertools.pairwise(DENSITIES)]
    for column in ("", *(f"{h:g} s" for h in ROBOT_HORIZONS_S), *(f"1.2 s, {band}/m2" for band in bands)):
        table.add_column(column, justify="left" if not column else "right")
    for name, row in rows.items():
        cells = [f"{row[f'error_{h:g}']:.3f} ({row[f'inside_50_{h:g}']:.0%})" for h in ROBOT_HORIZONS_S]
        table.add_row(name, *cells, *(f"{row['by_density'][band]:.3f}" for band in bands))
    return table


def _time_table(rows: Mapping[str, Any]) -> Table:
    table = Table(title="Time on this machine, one thread")
    for column in ("", "us a track, 1,000 at once", "ms for 15 people"):
        table.add_column(column, justify="left" if not column else "right")
    for name, row in rows.items():
        table.add_row(name, f"{row['us_a_track']:.2f}", f"{row['ms_for_15']:.3f}")
    return table


def _fold(kind: str, scene: str, folds: Path | None) -> str | Path | None:
    """The weights that have not seen a scene; None where there are none."""
    name = f"predictor-{kind}-field-without-{scene}"
    if folds is not None:
        path = folds / f"{name}.onnx"
        return path if path.is_file() else None
    return name if name in LEARNED.names() else None


def _between(density: Float[np.ndarray, "N"], low: float, high: float) -> Bool[np.ndarray, "N"]:
    return (density >= low) & (density < high)


def _mean(values: Float[np.ndarray, "..."]) -> float | None:
    """None where nothing is known."""
    return round(float(np.nanmean(values)), 4) if np.isfinite(values).any() else None
