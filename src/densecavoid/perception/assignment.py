"""Which detection belongs to which track: the assignment with the greatest total score, many worlds at a time.

Where everybody's first choice can be had, which is nearly always so, compiled code sees it; elsewhere scipy's Hungarian
method decides.
"""

from __future__ import annotations

import numpy as np

from densecavoid.sim._jit import kernel

NOBODY, CONTESTED = -1, -2
"""In place of a track: the detection belongs to no track; the Hungarian method must say."""


@kernel
def settle_uncontested(scores, match):
    """Settles one world, but for groups of tracks and detections where both a track and a detection are wanted twice.

    Tracks and detections that share a positive score form groups (connected components). Where the best tracks of a
    group's detections all differ, these pairs are the best assignment, as no detection can do better; and so where the
    best detections of its tracks all differ.

    Args:
        scores: [D, T]; a pair is possible where it is positive.
        match: [D], written: the track of each detection, `NOBODY` or `CONTESTED`.

    Returns:
        Whether anything is contested.
    """
    num_detections, num_tracks = scores.shape
    group = np.arange(num_detections + num_tracks)
    best_track, best_detection = np.full(num_detections, -1), np.full(num_tracks, -1)
    pairs, num_pairs = np.empty((num_detections * num_tracks, 2), np.int32), 0
    for d in range(num_detections):
        for t in range(num_tracks):
            if scores[d, t] > 0.0:
                pairs[num_pairs, 0], pairs[num_pairs, 1] = d, t
                num_pairs += 1
                if best_track[d] < 0 or scores[d, t] > scores[d, best_track[d]]:
                    best_track[d] = t
                if best_detection[t] < 0 or scores[d, t] > scores[best_detection[t], t]:
                    best_detection[t] = d
    changed = True
    while changed:
        changed = False
        for p in range(num_pairs):
            d, t = pairs[p, 0], num_detections + pairs[p, 1]
            least = min(group[d], group[t])
            changed |= group[d] != least or group[t] != least
            group[d] = group[t] = least
    track_wanted_twice = np.zeros(num_detections + num_tracks, np.bool_)  # by group
    detection_wanted_twice = np.zeros(num_detections + num_tracks, np.bool_)
    wanted = np.zeros(num_detections + num_tracks, np.bool_)
    for d in range(num_detections):
        t = best_track[d]
        if t >= 0:
            track_wanted_twice[group[d]] |= wanted[num_detections + t]
            wanted[num_detections + t] = True
    for t in range(num_tracks):
        d = best_detection[t]
        if d >= 0:
            detection_wanted_twice[group[num_detections + t]] |= wanted[d]
            wanted[d] = True
    contested = False
    for d in range(num_detections):
        match[d] = NOBODY
        if best_track[d] < 0:
            continue
        if not track_wanted_twice[group[d]]:
            match[d] = best_track[d]
        elif detection_wanted_twice[group[d]]:
            match[d] = CONTESTED
            contested = True
    for t in range(num_tracks):
        d = best_detection[t]
        if d >= 0 and track_wanted_twice[group[d]] and not detection_wanted_twice[group[d]]:
            match[d] = t
    return contested


def settle_contested(scores: np.ndarray, match: np.ndarray) -> None:
    """Settles what `settle_uncontested` left over in one world, in place."""
    from scipy.optimize import linear_sum_assignment  # takes a third of a second: robots load it before they drive

    rows = np.flatnonzero(match == CONTESTED)
    match[rows] = NOBODY
    # Pairs that are not possible count nothing, so that they are taken only where nothing better is left.
    gain = np.maximum(scores[rows], 0.0)
    chosen, tracks = linear_sum_assignment(gain, maximize=True)
    possible = gain[chosen, tracks] > 0.0
    match[rows[chosen[possible]]] = tracks[possible]
