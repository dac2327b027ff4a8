"""How well tracks follow people: CLEAR MOT (Bernardin and Stiefelhagen, EURASIP J. Image and Video Processing, 2008)
and identity scores (Ristani et al., ECCV Workshops, 2016).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import linear_sum_assignment

MATCH_M = 0.5
"""A track farther from a person does not follow them."""


class TrackingFrame(NamedTuple):
    """People and tracks at one instant, in one frame of reference."""

    person: Int[np.ndarray, "P"]
    """Names that stay."""
    person_pos: Float[np.ndarray, "P 2"]
    track: Int[np.ndarray, "T"]
    track_pos: Float[np.ndarray, "T 2"]


class TrackingScores(NamedTuple):
    """Counts and what follows from them."""

    people: int
    """Over all instants."""
    tracks: int
    misses: int
    false: int
    switches: int
    identity_hits: int
    """Instants at which people are followed by the track that is theirs in the best one-to-one naming."""
    error_m: float
    """Mean distance of matched tracks."""

    @property
    def mota(self) -> float:
        """1 - (misses + false + switches) / people."""
        return 1.0 - (self.misses + self.false + self.switches) / max(self.people, 1)

    @property
    def idf1(self) -> float:
        """Harmonic mean of the shares of people and of tracks whose name is right."""
        return 2.0 * self.identity_hits / max(self.people + self.tracks, 1)

    @property
    def precision(self) -> float:
        return 1.0 - self.false / max(self.tracks, 1)

    @property
    def recall(self) -> float:
        return 1.0 - self.misses / max(self.people, 1)

    def summary(self) -> dict[str, float]:
        """For tables and files."""
        names = ("mota", "idf1", "switches", "precision", "recall", "error_m", "misses", "false", "people")
        return {name: float(getattr(self, name)) for name in names}


def score_tracks(frames: Iterable[TrackingFrame], match_m: float = MATCH_M) -> TrackingScores:
    """Scores one sequence.

    At each instant a person keeps their track while it is within `match_m`; the rest are assigned so that most are
    matched, and then the distances are least.
    """
    held: dict[int, int] = {}
    together: Counter[tuple[int, int]] = Counter()
    people = tracks = misses = false = switches = matched = 0
    error = 0.0
    for frame in frames:
        apart = np.hypot(*(frame.person_pos[:, None] - frame.track_pos[None]).transpose(2, 0, 1))
        near = apart < match_m
        for p, t in np.argwhere(near):
            together[int(frame.person[p]), int(frame.track[t])] += 1
        pairs = _keep(frame, near, held)
        free_p = np.setdiff1d(np.arange(len(frame.person)), list(pairs))
        free_t = np.setdiff1d(np.arange(len(frame.track)), list(pairs.values()))
        cost = np.where(near, apart, 1e3)[np.ix_(free_p, free_t)]
        for row, column in zip(*linear_sum_assignment(cost), strict=True):
            if near[free_p[row], free_t[column]]:
                pairs[int(free_p[row])] = int(free_t[column])
        for p, t in pairs.items():
            person, track = int(frame.person[p]), int(frame.track[t])
            switches += held.get(person, track) != track
            held[person] = track
            error += apart[p, t]
        people += len(frame.person)
        tracks += len(frame.track)
        matched += len(pairs)
        misses += len(frame.person) - len(pairs)
        false += len(frame.track) - len(pairs)
    return TrackingScores(
        people, tracks, misses, false, switches, _identity_hits(together), error / matched if matched else float("nan")
    )


def pooled_scores(parts: list[TrackingScores]) -> TrackingScores:
    """Several sequences as one."""
    sums = [sum(column) for column in zip(*[part[:-1] for part in parts], strict=True)]
    matches = [part.people - part.misses for part in parts]
    errors = [part.error_m * n for part, n in zip(parts, matches, strict=True) if n]
    return TrackingScores(*sums, error_m=sum(errors) / sum(matches) if sum(matches) else float("nan"))  # type: ignore[arg-type]


def _keep(frame: TrackingFrame, near: np.ndarray, held: dict[int, int]) -> dict[int, int]:
    """Who still has the track they had: places in the frame's lists."""
    place = {int(track): t for t, track in enumerate(frame.track)}
    pairs: dict[int, int] = {}
    for p, person in enumerate(frame.person):
        t = place.get(held.get(int(person), -1))
        if t is not None and near[p, t] and t not in pairs.values():
            pairs[p] = t
    return pairs


def _identity_hits(together: Counter[tuple[int, int]]) -> int:
    """Most instants that a one-to-one naming of people by tracks can explain."""
    if not together:
        return 0
    people, tracks = (sorted({pair[k] for pair in together}) for k in range(2))
    table = np.zeros((len(people), len(tracks)))
    for (person, track), count in together.items():
        table[people.index(person), tracks.index(track)] = count
    return int(table[linear_sum_assignment(table, maximize=True)].sum())
