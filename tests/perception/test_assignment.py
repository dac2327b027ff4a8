"""The assignment of detections to tracks, against scipy and against all permutations."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment

from densecavoid.perception.assignment import CONTESTED, NOBODY, settle_contested, settle_uncontested


def assign(scores: np.ndarray) -> np.ndarray:
    match = np.empty(len(scores), np.int32)
    if settle_uncontested(scores, match):
        settle_contested(scores, match)
    return match


def total(scores: np.ndarray, match: np.ndarray) -> float:
    taken = match[match >= 0]
    assert len(set(taken.tolist())) == len(taken), "a track was given away twice"
    gained = scores[np.flatnonzero(match >= 0), taken]
    assert (gained > 0).all(), "a pair that is not possible"
    return float(gained.sum())


@pytest.mark.parametrize("share", [0.1, 0.25, 0.5, 1.0])
def test_the_total_score_is_scipys(share):
    rng = np.random.default_rng(int(100 * share))
    contested = 0
    for _ in range(300):
        shape = tuple(rng.integers(1, 9, 2))
        scores = np.where(rng.random(shape) < share, rng.random(shape), 0.0)
        padded = np.maximum(scores, 0.0)
        best = padded[linear_sum_assignment(padded, maximize=True)].sum()
        assert total(scores, assign(scores)) == pytest.approx(best, abs=1e-12)
        contested += settle_uncontested(scores, np.empty(len(scores), np.int32))
    assert share == 0.1 or contested > 0  # both ways were taken


def test_the_best_of_all_permutations_is_found_where_all_compete():
    rng = np.random.default_rng(3)
    for _ in range(50):
        scores = rng.random((4, 4)) + 0.1
        best = max(scores[range(4), list(order)].sum() for order in permutations(range(4)))
        assert total(scores, assign(scores)) == pytest.approx(best)


def test_a_better_pair_is_left_for_a_better_whole():
    """Nearest first would take .9 and leave .1; together the others have 1.5."""
    scores = np.array([[0.9, 0.8], [0.7, 0.1]])
    assert assign(scores).tolist() == [1, 0]


def test_only_those_who_compete_wait_for_the_hungarian_method():
    scores = np.zeros((4, 4))
    scores[:2, :2] = [[0.9, 0.8], [0.7, 0.1]]
    scores[2, 2] = 0.5
    match = np.empty(4, np.int32)
    assert settle_uncontested(scores, match)
    assert match.tolist() == [CONTESTED, CONTESTED, 2, NOBODY]
    settle_contested(scores, match)
    assert match.tolist() == [1, 0, 2, NOBODY]


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 6), st.integers(0, 6), st.integers(0, 2**32 - 1))
def test_no_track_is_given_twice_whatever_the_scores(detections, tracks, seed):
    rng = np.random.default_rng(seed)
    scores = rng.choice([-1.0, 0.0, 0.25, 0.5, 1e9], (detections, tracks))
    total(scores, assign(scores))
