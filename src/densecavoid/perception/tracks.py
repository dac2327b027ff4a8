"""The tracker's memory: everybody tracked in each world, as arrays."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from densecavoid.sim._jit import kernel

MAX_TRACKS = 32
HISTORY = 32
"""Places kept of each track, 3.2 s."""
HISTORY_DT_S = 0.1


class Tracks(NamedTuple):
    """Everybody tracked in each world. Slots that are not `live` hold no meaning."""

    state: np.ndarray  # f64 [B, T, 4] x, y, vx, vy in the odometry frame
    covariance: np.ndarray  # f64 [B, T, 3] of position, position-velocity, velocity; x and y share it
    modes: np.ndarray  # f64 [B, T, 3, 8] the same for who walks on and for who turns (`kalman.imm_begin`)
    body: np.ndarray  # f64 [B, T, 2] radius, height; a typical body's where no sensor could tell
    existence: np.ndarray  # f64 [B, T] log-odds that it is a person who is still there
    live: np.ndarray  # bool [B, T] the slot is in use
    confirmed: np.ndarray  # bool [B, T] surely a person: what predictors and policies look at
    by_camera: np.ndarray  # bool [B, T] a camera has seen it at least once
    unseen_s: np.ndarray  # f64 [B, T] since the last detection
    hits: np.ndarray  # i32 [B, T] detections so far
    id: np.ndarray  # i32 [B, T] stays with a track and is given to no other in the episode
    history: np.ndarray  # f32 [B, T, HISTORY, 2] estimated places every HISTORY_DT_S, the last is the latest
    history_count: np.ndarray  # i32 [B, T] how many of them (from the end) are filled; 0 is possible for the newest
    clock_s: np.ndarray  # f64 [B] since the history's last entry
    next_id: np.ndarray  # i32 [B]
    watched_s: np.ndarray  # f64 [B] time that people have been watched for, added up over them,
    turning_s: np.ndarray  # f64 [B] and of it, as far as can be told, the time in which they turned


def allocate_tracks(num_worlds: int) -> Tracks:
    """No tracks in any world."""
    shape = (num_worlds, MAX_TRACKS)
    return Tracks(
        state=np.zeros((*shape, 4)),
        covariance=np.zeros((*shape, 3)),
        modes=np.zeros((*shape, 3, 8)),
        body=np.zeros((*shape, 2)),
        existence=np.zeros(shape),
        live=np.zeros(shape, np.bool_),
        confirmed=np.zeros(shape, np.bool_),
        by_camera=np.zeros(shape, np.bool_),
        unseen_s=np.zeros(shape),
        hits=np.zeros(shape, np.int32),
        id=np.zeros(shape, np.int32),
        history=np.zeros((*shape, HISTORY, 2), np.float32),
        history_count=np.zeros(shape, np.int32),
        clock_s=np.zeros(num_worlds),
        next_id=np.zeros(num_worlds, np.int32),
        watched_s=np.zeros(num_worlds),
        turning_s=np.zeros(num_worlds),
    )


@kernel
def forget(tracks, b):
    """Drops all tracks of world b, and what they told of people there."""
    tracks.watched_s[b] = tracks.turning_s[b] = 0.0
    tracks.live[b] = False
    tracks.confirmed[b] = False
    tracks.clock_s[b] = 0.0
    tracks.next_id[b] = 0


@kernel
def remember(tracks, b, t, ago_s):
    """Adds where track t of world b was `ago_s` ago to its history."""
    history = tracks.history[b, t]
    for k in range(HISTORY - 1):
        history[k, 0], history[k, 1] = history[k + 1, 0], history[k + 1, 1]
    for axis in range(2):
        history[HISTORY - 1, axis] = tracks.state[b, t, axis] - ago_s * tracks.state[b, t, 2 + axis]
    tracks.history_count[b, t] = min(tracks.history_count[b, t] + 1, HISTORY)
