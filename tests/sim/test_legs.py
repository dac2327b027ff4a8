"""Legs seen by a lidar at shin height: simulated people against real scans, measured by one extractor."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import legs
from densecavoid.frames import LidarConfig

WIDTH_M, SEPARATION_M = 0.137, 0.288
"""Medians of real people's clusters (FACTS, Crowds)."""
INCREMENT_RAD = 0.00613592
URG = LidarConfig(768, 767 * INCREMENT_RAD, 11.0, 0.03)
"""The recordings' scanner."""


@pytest.fixture(scope="module")
def both(data_dir: Path) -> tuple[legs.Legs, legs.Legs]:
    if not any((data_dir / "leg_tracker").glob("*_extracted.npz")):
        pytest.skip(f"no leg_tracker/*_extracted.npz in {data_dir}")
    return legs.compare(data_dir, repeats=3)


def scan_of_discs(*discs: tuple[float, float, float]) -> np.ndarray:
    """Ranges to discs (x, y, radius) from the origin, by hand."""
    ranges = np.full(URG.num_rays, np.inf)
    for x, y, radius in discs:
        along = x * np.cos(URG.angles_rad) + y * np.sin(URG.angles_rad)
        across = x * np.sin(URG.angles_rad) - y * np.cos(URG.angles_rad)
        hit = (np.abs(across) < radius) & (along > 0)
        ranges[hit] = np.minimum(ranges[hit], (along - np.sqrt(np.maximum(radius**2 - across**2, 0)))[hit])
    return ranges


def test_the_extractor_measures_two_discs_and_joins_them_when_they_come_near():
    place, step = np.array([2.0, 0.0]), 2.0 * INCREMENT_RAD
    apart = legs.measure(scan_of_discs((2.0, 0.16, 0.06), (2.0, -0.16, 0.06))[None], URG.angles_rad, place[None])
    assert apart.shown.tolist() == [2]
    assert apart.separation_m == pytest.approx([0.32], abs=step)
    assert apart.width_m == pytest.approx([0.12, 0.12], abs=2 * step)
    near = legs.measure(scan_of_discs((2.0, 0.09, 0.06), (2.0, -0.09, 0.06))[None], URG.angles_rad, place[None])
    assert near.shown.tolist() == [1] and near.single == 1.0 and not len(near.separation_m)
    assert near.width_m == pytest.approx([0.30], abs=2 * step)
    elsewhere = legs.measure(scan_of_discs((2.0, 1.0, 0.06))[None], URG.angles_rad, place[None])
    assert elsewhere.shown.tolist() == [0]


@pytest.mark.slow
def test_the_extractor_finds_what_is_known_of_the_real_scans(both):
    real, _ = both
    assert len(real.width_m) > 900 and len(real.separation_m) > 250
    assert np.median(real.width_m) == pytest.approx(WIDTH_M, rel=0.03)
    assert np.median(real.separation_m) == pytest.approx(SEPARATION_M, rel=0.03)


@pytest.mark.slow
def test_simulated_legs_match_the_real_scans(both):
    real, simulated = both
    for name in ("width_m", "separation_m"):
        ours, theirs = getattr(simulated, name), getattr(real, name)
        assert np.median(ours) == pytest.approx(np.median(theirs), rel=0.08), name
    for share in (25, 75):
        ours, theirs = np.percentile(simulated.separation_m, share), np.percentile(real.separation_m, share)
        assert ours == pytest.approx(theirs, rel=0.15)
    assert simulated.single == pytest.approx(real.single, abs=0.10)


def test_simulated_legs_have_the_known_width_and_separation():
    """People between .9 and 5 m from the scanner who walk to it or away at the recorded speeds, up to 1.3 m/s."""
    rng = np.random.default_rng(1)
    count = 800
    distance, bearing, turn = rng.uniform(0.9, 5.0, count), rng.normal(0, 0.1, count), rng.normal(0, 0.1, count)
    speed = rng.uniform(0.05, 1.3, count) * rng.choice([-1.0, 1.0], count)
    angle = bearing + turn
    rows = np.stack(
        [distance * np.cos(bearing), distance * np.sin(bearing), speed * np.cos(angle), speed * np.sin(angle)], axis=1
    )
    found = legs.simulate(URG, rows)
    assert np.median(found.width_m) == pytest.approx(WIDTH_M, rel=0.15)
    assert np.median(found.separation_m) == pytest.approx(SEPARATION_M, rel=0.15)


def test_a_walker_shows_two_legs_that_pass_each_other():
    """Seen from the side: twice a stride the legs hide each other, between which they are a shin's step apart."""
    rows = np.tile([2.0, 0.0, 0.0, 1.3], (200, 1))
    found = legs.simulate(URG, rows)
    assert set(found.shown) == {1, 2}
    assert np.percentile(found.separation_m, 95) == pytest.approx(0.58 * 0.73, rel=0.1)
    standing = legs.simulate(URG, rows * [1, 1, 0, 0] + [0, 0, 0.0, 0.0])
    assert (standing.shown >= 1).all() and math.isclose(standing.single, 1.0, abs_tol=0.05)
