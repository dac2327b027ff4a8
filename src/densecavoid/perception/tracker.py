"""Tracks of people in the odometry frame: a constant-velocity Kalman filter each, matched to detections nearest first.

All worlds are tracked at once; a robot is a batch of one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from densecavoid.sim._jit import inner, kernel

MAX_TRACKS = 32
GATE_M = 0.6  # a detection farther than this from every predicted track is somebody new
MAX_COAST_S = 1.0  # a track not seen for longer is given up
_ACCELERATION_STD = 1.0  # m/s2, how people's velocity wanders
_MEASUREMENT_STD_M = 0.05
_NEW_SPEED_STD = 1.0  # m/s


class Tracks(NamedTuple):
    """Everybody tracked in each world. Position and velocity share one 2 x 2 covariance for x and y."""

    state: np.ndarray  # f64 [B, T, 4] x, y, vx, vy in the odometry frame
    covariance: np.ndarray  # f64 [B, T, 3] of position, position-velocity, velocity
    body: np.ndarray  # f64 [B, T, 2] radius, height
    unseen_s: np.ndarray  # f64 [B, T] since the last detection
    hits: np.ndarray  # i32 [B, T] detections so far; 0: the slot is free
    id: np.ndarray  # i32 [B, T]
    next_id: np.ndarray  # i32 [B]


def allocate_tracks(num_worlds: int) -> Tracks:
    """No tracks in any world."""
    return Tracks(
        state=np.zeros((num_worlds, MAX_TRACKS, 4)),
        covariance=np.zeros((num_worlds, MAX_TRACKS, 3)),
        body=np.zeros((num_worlds, MAX_TRACKS, 2)),
        unseen_s=np.zeros((num_worlds, MAX_TRACKS)),
        hits=np.zeros((num_worlds, MAX_TRACKS), np.int32),
        id=np.zeros((num_worlds, MAX_TRACKS), np.int32),
        next_id=np.zeros(num_worlds, np.int32),
    )


@kernel
def forget(tracks, b):
    """Drops all tracks of world b."""
    tracks.hits[b] = 0
    tracks.next_id[b] = 0


@inner
def _predict(tracks, b, dt):
    """Kalman prediction with white acceleration noise (Bar-Shalom, Li, Kirubarajan 2001, section 6.2.3)."""
    q = _ACCELERATION_STD**2
    for t in range(tracks.hits.shape[1]):
        if tracks.hits[b, t] == 0:
            continue
        state, cov = tracks.state[b, t], tracks.covariance[b, t]
        state[0] += state[2] * dt
        state[1] += state[3] * dt
        cov[0] += 2.0 * dt * cov[1] + dt * dt * cov[2] + q * dt**4 / 4.0
        cov[1] += dt * cov[2] + q * dt**3 / 2.0
        cov[2] += q * dt * dt
        tracks.unseen_s[b, t] += dt
        if tracks.unseen_s[b, t] > MAX_COAST_S:
            tracks.hits[b, t] = 0


@inner
def _correct(tracks, b, t, x, y, radius, height):
    state, cov = tracks.state[b, t], tracks.covariance[b, t]
    innovation = cov[0] + _MEASUREMENT_STD_M**2
    gain_pos, gain_vel = cov[0] / innovation, cov[1] / innovation
    miss_x, miss_y = x - state[0], y - state[1]
    state[0] += gain_pos * miss_x
    state[1] += gain_pos * miss_y
    state[2] += gain_vel * miss_x
    state[3] += gain_vel * miss_y
    cov[2] -= gain_vel * cov[1]
    cov[1] *= 1.0 - gain_pos
    cov[0] *= 1.0 - gain_pos
    tracks.body[b, t, 0], tracks.body[b, t, 1] = radius, height
    tracks.unseen_s[b, t] = 0.0
    tracks.hits[b, t] += 1


@inner
def _begin_track(tracks, b, x, y, radius, height):
    for t in range(tracks.hits.shape[1]):
        if tracks.hits[b, t] == 0:
            tracks.state[b, t, 0], tracks.state[b, t, 1] = x, y
            tracks.state[b, t, 2], tracks.state[b, t, 3] = 0.0, 0.0
            tracks.covariance[b, t, 0] = _MEASUREMENT_STD_M**2
            tracks.covariance[b, t, 1] = 0.0
            tracks.covariance[b, t, 2] = _NEW_SPEED_STD**2
            tracks.body[b, t, 0], tracks.body[b, t, 1] = radius, height
            tracks.unseen_s[b, t] = 0.0
            tracks.hits[b, t] = 1
            tracks.id[b, t] = tracks.next_id[b]
            tracks.next_id[b] += 1
            return


@kernel
def update_tracks(tracks, b, detections, dt):
    """Takes in the detections [D, 4] (x, y in the odometry frame, radius, height) of world b, `dt` s after the last."""
    _predict(tracks, b, dt)
    num_detections, num_tracks = detections.shape[0], tracks.hits.shape[1]
    taken = np.zeros(num_tracks, np.bool_)
    used = np.zeros(num_detections, np.bool_)
    for _ in range(num_detections):
        best, best_d, best_t = GATE_M * GATE_M, -1, -1
        for d in range(num_detections):
            if used[d]:
                continue
            for t in range(num_tracks):
                if tracks.hits[b, t] == 0 or taken[t]:
                    continue
                off_x = detections[d, 0] - tracks.state[b, t, 0]
                off_y = detections[d, 1] - tracks.state[b, t, 1]
                if off_x * off_x + off_y * off_y < best:
                    best, best_d, best_t = off_x * off_x + off_y * off_y, d, t
        if best_d < 0:
            break
        used[best_d] = taken[best_t] = True
        _correct(
            tracks,
            b,
            best_t,
            detections[best_d, 0],
            detections[best_d, 1],
            detections[best_d, 2],
            detections[best_d, 3],
        )
    for d in range(num_detections):
        if not used[d]:
            _begin_track(tracks, b, detections[d, 0], detections[d, 1], detections[d, 2], detections[d, 3])
