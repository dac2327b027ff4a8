"""Intervals against published and independently computed values."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binomtest, norm

from densecavoid.benchmark.statistics import paired_bootstrap, wilson_interval


def test_wilson_interval_is_the_published_one():
    """R. G. Newcombe, Statistics in Medicine 17 (1998), table I, method 3: 81/263, 15/148, 0/20, 1/29."""
    assert wilson_interval(81, 263) == pytest.approx((0.2553, 0.3662), abs=5e-5)
    assert wilson_interval(15, 148) == pytest.approx((0.0624, 0.1605), abs=5e-5)
    assert wilson_interval(0, 20) == pytest.approx((0.0, 0.1611), abs=5e-5)
    assert wilson_interval(1, 29) == pytest.approx((0.0061, 0.1718), abs=5e-5)


@pytest.mark.parametrize(("successes", "trials"), [(0, 1), (1, 1), (7, 15), (15, 15), (499, 500), (250, 500)])
@pytest.mark.parametrize("confidence", [0.8, 0.95, 0.99])
def test_wilson_interval_agrees_with_scipy(successes: int, trials: int, confidence: float):
    expected = binomtest(successes, trials).proportion_ci(confidence, method="wilson")
    assert wilson_interval(successes, trials, confidence) == pytest.approx((expected.low, expected.high), abs=1e-12)


def test_nothing_tried_is_nothing_known():
    assert wilson_interval(0, 0) == (0.0, 1.0)


@pytest.mark.parametrize(("successes", "trials", "confidence"), [(3, 2, 0.95), (-1, 2, 0.95), (1, 2, 1.0)])
def test_impossible_counts_are_refused(successes, trials, confidence):
    with pytest.raises(ValueError, match="expected"):
        wilson_interval(successes, trials, confidence)


def test_bootstrap_interval_of_a_mean_is_the_normal_one():
    rng = np.random.default_rng(3)
    a, b = rng.normal(1.0, 1.0, 400), rng.normal(0.7, 1.0, 400)
    found = paired_bootstrap(a, b)
    half = norm.ppf(0.975) * (a - b).std() / np.sqrt(400)
    assert found.mean == pytest.approx((a - b).mean())
    assert (found.low, found.high) == pytest.approx((found.mean - half, found.mean + half), abs=0.15 * half)
    assert found.excludes_zero


def test_pairing_finds_what_unpaired_samples_hide():
    """One is better by .01 in every world, among worlds that differ by much more."""
    worlds = np.linspace(0, 1, 50)
    difference = paired_bootstrap(worlds + 0.01, worlds)
    assert difference.low > 0.009
    assert difference.high < 0.011


def test_bootstrap_repeats_with_its_seed_and_differs_with_another():
    a, b = np.arange(10.0), np.arange(10.0)[::-1].copy()
    assert paired_bootstrap(a, b, seed=1) == paired_bootstrap(a, b, seed=1)
    assert paired_bootstrap(a, b, seed=1, resamples=50) != paired_bootstrap(a, b, seed=2, resamples=50)


@pytest.mark.parametrize("values", [np.zeros(0), np.array([0.5, np.nan])])
def test_pairs_that_have_no_mean_are_refused(values):
    with pytest.raises(ValueError, match="expected"):
        paired_bootstrap(values, values)
