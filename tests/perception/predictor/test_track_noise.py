"""What a tracker would hand over: exact where there is no noise, wrong in the ways and shares that are asked for."""

from __future__ import annotations

import numpy as np
import pytest

from densecavoid.perception.predictor.track_noise import TrackNoise, as_tracked, jittered
from densecavoid.perception.predictor.windows import Windows, cut

NONE = TrackNoise(0.0, 0.0, 0.0, 0.0, 0.0)


def straight(people: int = 400) -> Windows:
    """Pairs that walk side by side, .7 m apart, at 1 m/s."""
    places = np.zeros((33, people, 2))
    places[..., 0] = 0.1 * np.arange(33)[:, None] + 20.0 * (np.arange(people) // 2)
    places[..., 1] = 0.7 * (np.arange(people) % 2)
    return cut(places, 0.1, 32, (1,), complete=True)


def test_a_perfect_tracker_follows_a_straight_walk() -> None:
    windows = straight(4)
    tracked = as_tracked(windows, NONE, np.random.default_rng(0))
    np.testing.assert_allclose(tracked.pos[:, -8:], windows.pos[:, -8:], atol=0.01)
    np.testing.assert_allclose(tracked.velocity, [[1.0, 0.0]] * 4, atol=0.01)
    np.testing.assert_array_equal(tracked.future, windows.future)


def test_noise_is_as_large_as_asked_and_the_filter_takes_part_of_it() -> None:
    windows = straight()
    tracked = as_tracked(windows, TrackNoise(0.2, 0.0, 0.0, 0.0, 0.0), np.random.default_rng(1))
    error = np.linalg.norm(tracked.pos[:, 20:] - windows.pos[:, 20:], axis=2)
    raw = 0.1 * np.sqrt(np.pi / 2)  # mean length of a jitter of .1 m, the middle of its range
    assert 0.3 * raw < error.mean() < 0.8 * raw


def test_tracks_are_born_late_as_often_as_asked() -> None:
    windows = straight()
    tracked = as_tracked(windows, TrackNoise(0.0, 0.0, 0.0, 0.5, 0.0), np.random.default_rng(2))
    late = ~tracked.valid[:, 0]
    assert 0.4 < late.mean() < 0.6
    assert tracked.valid[:, -1].all() and (np.diff(tracked.valid.astype(int), axis=1) >= 0).all()


def test_switched_tracks_carry_a_neighbours_past() -> None:
    windows = straight()
    tracked = as_tracked(windows, TrackNoise(0.0, 0.0, 0.0, 0.0, 1.0), np.random.default_rng(3))
    from_other = np.abs(tracked.pos[:, 0, 1] - windows.pos[:, 0, 1]) > 0.6
    # A partner is drawn at random among 400, of whom one is within a metre: hardly anybody switches.
    assert from_other.mean() < 0.05
    pair = windows.subset(np.arange(2))
    switched = [
        np.abs(as_tracked(pair, TrackNoise(0, 0, 0, 0, 1.0), np.random.default_rng(k)).pos[:, 0, 1] - [0.0, 0.7]) > 0.6
        for k in range(50)
    ]
    assert 0.3 < np.mean(switched) < 0.7  # half of the draws are oneself


def test_the_same_seed_gives_the_same_tracks_and_jitter_needs_no_tracker() -> None:
    windows = straight(10)
    first, second = (as_tracked(windows, TrackNoise(), np.random.default_rng(7)) for _ in range(2))
    np.testing.assert_array_equal(first.pos, second.pos)
    shaken = jittered(windows, 0.1, np.random.default_rng(8))
    assert 0.0 < np.abs(shaken.pos - windows.pos).mean() < 0.08 and np.isnan(shaken.velocity).all()


def test_wrong_noise_is_refused_by_name() -> None:
    with pytest.raises(ValueError, match=r"TrackNoise\.miss_rate is 1\.5"):
        TrackNoise(miss_rate=1.5)
