"""Simulated crowds walk as recorded ones do (benchmarks/crowds.py prints and draws all densities)."""

from __future__ import annotations

import json

import numpy as np
import pytest

from crowds import DENSITIES, Ring, Samples, compare, join, lane_order, recorded, simulate


@pytest.mark.slow
@pytest.mark.parametrize("key", ["uni", "bi"])
def test_speed_and_distances_are_those_of_recorded_corridors(key, data_dir):
    """One-way and two-way, from .4 to 2.6 people per m2."""
    diagram = json.loads((data_dir / "hermes" / "fundamental_diagram.json").read_text())
    parts = [simulate(Ring(density, key == "bi"), 2, 8.0, "anticipation")[0] for density in DENSITIES]
    table = compare(diagram[key], join(parts))
    assert len(table) == len(DENSITIES)
    for row in table:
        assert row["v_mean"] == pytest.approx(row["recorded_v_mean"], rel=0.1)
        if row["recorded_rho"] >= 0.4:  # the sparsest ring falls into a bin that begins below what is compared
            assert row["nn_p50"] == pytest.approx(row["recorded_nn_p50"], rel=0.15)


@pytest.mark.slow
@pytest.mark.parametrize("density", [0.6, 1.1, 1.6, 2.1])
def test_people_who_walk_both_ways_form_lanes(density):
    _, lanes, rings = simulate(Ring(density, True), 2, 8.0, "anticipation")
    order, dealt = np.nanmean(lanes, axis=0)
    assert order > dealt + 0.15
    assert (
        np.hypot(*rings.simulator._state.vel[0, : rings.count].T) > 0.3
    ).mean() > 0.5  # and do not block one another


def test_the_recordings_are_measured_as_the_diagram_was(data_dir):
    """The same figures from the raw tracks as in the published table, which holds more runs than are here."""
    diagram = json.loads((data_dir / "hermes" / "fundamental_diagram.json").read_text())
    samples, order, shuffled = recorded(data_dir, ("bo-360-050-050", "bo-360-090-090", "boa-300-065-105"))
    for row in compare(diagram["bi"], samples):
        if 0.5 <= row["recorded_rho_lo"] <= 1.0:
            assert row["v_mean"] == pytest.approx(row["recorded_v_mean"], rel=0.06)
            assert row["nn_p50"] == pytest.approx(row["recorded_nn_p50"], rel=0.08)
    assert order > shuffled + 0.1


def test_people_in_lanes_are_ordered_and_dealt_people_are_not():
    rng = np.random.default_rng(0)
    across = np.repeat([0.2, 1.0, 1.8, 2.6], 10) + rng.normal(0, 0.02, 40)
    way = np.repeat([1.0, 1.0, -1.0, -1.0], 10)
    order, dealt = lane_order(across, way, rng)
    assert order == pytest.approx(1.0)
    assert dealt < 0.35


def test_a_bin_of_density_is_the_mean_of_those_in_it():
    samples = Samples(np.array([1.0, 1.1, 1.3]), np.array([1.0, 2.0, 9.0]), np.array([0.4, 0.6, 0.1]))
    row = samples.bin(1.0)
    assert (row["n"], row["v_mean"], row["nn_p50"]) == (2, 1.5, 0.5)
