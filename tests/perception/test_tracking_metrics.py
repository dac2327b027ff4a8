"""Scores of tracks: by hand, and against py-motmetrics."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from densecavoid.perception.metrics import TrackingFrame, pooled_scores, score_tracks


def frame(people: dict[int, tuple[float, float]], tracks: dict[int, tuple[float, float]]) -> TrackingFrame:
    def columns(named):
        return np.array(list(named), np.int64), np.array(list(named.values()), float).reshape(-1, 2)

    return TrackingFrame(*columns(people), *columns(tracks))


def test_a_switch_a_miss_and_a_false_track_by_hand():
    a, b = (0.0, 0.0), (3.0, 0.0)
    frames = [
        frame({1: a, 2: b}, {7: a, 8: b}),
        frame({1: a, 2: b}, {7: a, 8: (3.4, 0.0)}),
        frame({1: a, 2: b}, {8: a, 7: b}),  # two switches
        frame({1: a, 2: b}, {8: a, 9: (9.0, 0.0)}),  # 2 is missed, 9 is false
    ]
    scores = score_tracks(frames)
    assert (scores.people, scores.tracks, scores.misses, scores.false, scores.switches) == (8, 8, 1, 1, 2)
    assert scores.mota == pytest.approx(1 - 4 / 8)
    # 1 is best named 7 (or 8), 2 then 8 (or 7): two instants each of 1, and of 2 two with 8 or one with 7
    assert scores.identity_hits == 4 and scores.idf1 == pytest.approx(2 * 4 / 16)
    assert scores.error_m == pytest.approx(0.4 / 7)


def test_a_person_keeps_their_track_while_it_is_near_even_if_another_is_nearer():
    frames = [frame({1: (0.0, 0.0)}, {5: (0.0, 0.0)}), frame({1: (0.0, 0.0)}, {5: (0.4, 0.0), 6: (0.0, 0.0)})]
    scores = score_tracks(frames)
    assert scores.switches == 0 and scores.false == 1


def test_nobody_and_nothing_score_nothing():
    scores = score_tracks([frame({}, {}), frame({}, {})])
    assert scores.mota == 1.0 and scores.idf1 == 0.0 and np.isnan(scores.error_m)


def random_walks(seed: int) -> list[TrackingFrame]:
    """People walk; tracks follow, are lost, change names and appear from nowhere."""
    rng = np.random.default_rng(seed)
    pos, names, frames = rng.uniform(0, 4, (6, 2)), np.arange(6), []
    for _ in range(60):
        pos = pos + rng.normal(0, 0.1, pos.shape)
        if rng.random() < 0.1:
            i, j = rng.choice(6, 2, replace=False)
            names[[i, j]] = names[[j, i]]
        if rng.random() < 0.1:
            names[rng.integers(6)] = names.max() + 1
        here, followed = rng.random(6) < 0.9, rng.random(6) < 0.85
        tracks = {
            int(n): tuple(p)
            for n, p in zip(names[followed], pos[followed] + rng.normal(0, 0.15, (6, 2))[followed], strict=True)
        }
        if rng.random() < 0.3:
            tracks[1000 + len(frames)] = tuple(rng.uniform(0, 4, 2))
        frames.append(frame({int(k): tuple(pos[k]) for k in np.flatnonzero(here)}, tracks))
    return frames


@pytest.mark.parametrize("seed", range(5))
def test_scores_are_those_of_py_motmetrics(seed):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        motmetrics = pytest.importorskip("motmetrics")
        frames = random_walks(seed)
        theirs = motmetrics.MOTAccumulator(auto_id=True)
        for one in frames:
            apart = np.hypot(*(one.person_pos[:, None] - one.track_pos[None]).transpose(2, 0, 1))
            theirs.update(one.person, one.track, np.where(apart < 0.5, apart, np.nan))
        names = ["mota", "idf1", "num_switches", "num_misses", "num_false_positives", "motp"]
        table = motmetrics.metrics.create().compute(theirs, metrics=names, name="x").loc["x"]
    ours = score_tracks(frames)
    assert (ours.switches, ours.misses, ours.false) == tuple(int(table[name]) for name in names[2:5])
    assert ours.mota == pytest.approx(table["mota"]) and ours.idf1 == pytest.approx(table["idf1"])
    assert ours.error_m == pytest.approx(table["motp"])


def test_pooled_scores_are_those_of_all_instants():
    parts = [score_tracks(random_walks(seed)) for seed in range(3)]
    together = pooled_scores(parts)
    assert together.people == sum(part.people for part in parts)
    assert together.mota == pytest.approx(np.average([p.mota for p in parts], weights=[p.people for p in parts]))
    assert min(p.idf1 for p in parts) < together.idf1 < max(p.idf1 for p in parts)
