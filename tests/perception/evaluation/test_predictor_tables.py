"""Tables of prediction: figures of a predictor whose errors are known, and what the shipped weights promise."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from densecavoid.perception.evaluation.predictor import (
    Thinned,
    evaluate_predictors,
    hermes_test_windows,
    robot_row,
    tables,
    timing,
)
from densecavoid.perception.evaluation.predictor_picture import draw_prediction_sheet
from densecavoid.perception.predictor.constant_velocity import ConstantVelocity
from densecavoid.perception.predictor.contract import Histories, Prediction
from densecavoid.perception.predictor.learned import LEARNED
from densecavoid.perception.predictor.windows import Windows, cut


def crowd(density: float) -> Windows:
    """Four people at 1 m/s along x."""
    places = np.zeros((50, 4, 2))
    places[..., 0] = 0.1 * np.arange(50)[:, None]
    places[..., 1] = np.arange(4)
    return cut(places, 0.1, 32, (1, 4, 8, 12), complete=True, density=np.full((50, 4), density))


class Off:
    """Right but for .1 m a second to the left, and Gaussians of .1 m."""

    name = "off"

    def predict(self, histories: Histories, horizons_s: Sequence[float]) -> Prediction:
        horizons = np.asarray(horizons_s)[:, None]
        mean = histories.pos[:, -1:] + horizons * np.array([1.0, 0.1])
        return Prediction(mean, np.tile([0.01, 0.0, 0.01], (*mean.shape[:2], 1)))


def test_a_row_holds_errors_coverage_and_densities() -> None:
    row = robot_row(Off(), crowd(1.1))
    assert (row["fde3"], row["error_0.4"], row["error_0.1"]) == (0.12, 0.04, 0.01)
    assert row["ade3"] == pytest.approx((0.04 + 0.08 + 0.12) / 3)
    # .12 m is outside the 50 % ellipse of .1 m, whose radius is .118 m; .08 m is inside.
    assert (row["inside_50_0.8"], row["inside_50_1.2"]) == (1.0, 0.0)
    assert row["by_density"]["1-1.25"] == 0.12 and row["by_density"]["0.5-0.75"] is None


def test_people_outside_the_required_densities_are_not_counted() -> None:
    assert robot_row(Off(), crowd(1.1))["people"] == len(crowd(1.1))
    assert robot_row(Off(), crowd(1.7))["people"] == 0


def test_a_thinned_predictor_sees_every_fourth_place() -> None:
    class Counts(Off):
        def predict(self, histories: Histories, horizons_s: Sequence[float]) -> Prediction:
            assert histories.period_s == 0.4 and histories.valid.shape[1] == 8
            np.testing.assert_allclose(np.diff(histories.pos[0, :, 0]), 0.4, rtol=1e-5)
            return super().predict(histories, horizons_s)

    assert Thinned(Counts()).predict(crowd(1.0).histories(), (0.4,)).mean.shape == (len(crowd(1.0)), 1, 2)


def test_timing_tells_both_forms() -> None:
    figures = timing(ConstantVelocity(), repeats=3)
    assert set(figures) == {"us_a_track", "ms_for_15"} and min(figures.values()) > 0


@pytest.mark.slow
@pytest.mark.skipif("predictor-compact-robot" not in LEARNED.names(), reason="no weights are shipped")
def test_shipped_weights_beat_what_learns_nothing_on_runs_they_have_not_seen(data_dir: Path, tmp_path: Path) -> None:
    results = evaluate_predictors(data_dir)
    for people in ("hermes", "tracked"):
        rows = results[people]
        others = [row["fde3"] for name, row in rows.items() if name.startswith(("constant-velocity", "kalman"))]
        assert rows["compact"]["fde3"] <= 0.85 * min(others), people
    for horizon in (0.8, 1.2):
        assert 0.45 <= results["hermes"]["compact"][f"inside_50_{horizon:g}"] <= 0.55
    assert results["eth_ucy"]["constant-velocity"]["fde12"] == pytest.approx(1.141, abs=1e-3)
    assert results["eth_ucy"]["compact"]["ade12"] < results["eth_ucy"]["constant-velocity"]["ade12"]

    console = Console(width=200, record=True)
    for table in tables(results):
        console.print(table)
    text = console.export_text()
    assert "HERMES two-way" in text and "compact" in text
    draw_prediction_sheet(tmp_path / "sheet" / "predictions.png", hermes_test_windows(data_dir), results)
    assert (tmp_path / "sheet" / "predictions.png").stat().st_size > 50_000
