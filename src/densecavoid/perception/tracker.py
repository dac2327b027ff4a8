"""Tracks of people in the odometry frame, from camera and lidar: of each, two Kalman filters that interact.

Each sensor's detections are assigned to the tracks and taken in one sensor after the other, so that what both see
becomes one track. Tracks are born and die by evidence: a detection counts for a person's being there, a miss counts
against it as far as the sensor ought to have seen them. All worlds are tracked at once; a robot is a batch of one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from densecavoid.frames import require
from densecavoid.perception.assignment import NOBODY, settle_contested, settle_uncontested
from densecavoid.perception.detections import MAX_DETECTIONS, Detections
from densecavoid.perception.kalman import imm_begin, imm_correct, imm_predict
from densecavoid.perception.tracker_settings import TrackerSettings
from densecavoid.perception.tracks import HISTORY, HISTORY_DT_S, MAX_TRACKS, Tracks, allocate_tracks, forget, remember
from densecavoid.perception.visibility import DepthView, LidarView, legs_seen_by_lidar, seen_by_camera
from densecavoid.sim._jit import for_worlds, inner, kernel, threads_for

TYPICAL_BODY = (0.255, 1.71)
"""Radius and height in m of a person of whom only the legs are seen (adults: sim/people.py)."""

_LEAST_STD_M = 0.02
_FARTHEST_M = 1e4  # what is reported farther from the origin is no position
_INSEPARABLE_M = 0.3  # nearer than that people do not stand (first percentile of neighbours' distances in crowds)
_UNUSABLE = -3  # in place of a track: beside assignment.NOBODY and CONTESTED
_HITS_TO_KNOW = 10  # after so many detections a velocity has settled: until then everybody seems to turn
_SAME_PERSON_M = 0.5  # a leg so near to a tracked person is theirs


class Sighting(NamedTuple):
    """What one sensor found, and what it looked at."""

    detections: Detections
    view: DepthView | LidarView


@kernel
def _predict(first, last, which, tracks, settings, dt):
    for b in range(first, last):
        if which[b]:
            for t in range(tracks.live.shape[1]):
                if tracks.live[b, t]:
                    imm_predict(tracks.modes[b, t], tracks.state[b, t], tracks.covariance[b, t], dt, settings)
                    tracks.unseen_s[b, t] += dt
                    tracks.existence[b, t] -= settings.forgotten_per_s * dt


@inner
def _is_usable(detections, b, d):
    x, y = detections.pos[b, d, 0], detections.pos[b, d, 1]
    near = abs(x) < _FARTHEST_M and abs(y) < _FARTHEST_M  # NaN is not
    return near and detections.std_m[b, d] < _FARTHEST_M and detections.confidence[b, d] > 0.0


@kernel
def _score(tracks, settings, b, detections, rows, columns, scores):
    """Log-likelihood that each detection of `rows` comes from each track of `columns`, over that it is somebody new
    (Blackman and Popoli, Design and Analysis of Modern Tracking Systems, 1999, section 6.2). Where two people cannot
    stand it is the track's at the worst, whatever the filter thinks of it."""
    for i in range(len(rows)):
        d = rows[i]
        std = max(detections.std_m[b, d], _LEAST_STD_M)
        for j in range(len(columns)):
            t = columns[j]
            variance = tracks.covariance[b, t, 0] + std * std
            off_x = detections.pos[b, d, 0] - tracks.state[b, t, 0]
            off_y = detections.pos[b, d, 1] - tracks.state[b, t, 1]
            off2 = off_x * off_x + off_y * off_y
            gain = 0.0
            if off2 < settings.gate * variance:
                gain = -math.log(2.0 * math.pi * variance * settings.newcomers_per_m2) - 0.5 * off2 / variance
            if off2 < _INSEPARABLE_M**2:
                gain = max(gain, 1e-3 * (_INSEPARABLE_M**2 - off2))
            scores[i, j] = gain


@kernel
def _assign(first, last, which, tracks, settings, detections, match, scores, contested):
    """Writes the track of each detection into `match` [B, D], and the scores of worlds that are `contested`."""
    slots, room = tracks.live.shape[1], detections.pos.shape[1]
    rows, columns = np.empty(room, np.int32), np.empty(slots, np.int32)
    for b in range(first, last):
        contested[b] = False
        if not which[b]:
            continue
        num_rows = num_columns = 0
        for d in range(room):
            match[b, d] = _UNUSABLE
            if d < detections.count[b] and _is_usable(detections, b, d):
                match[b, d] = NOBODY
                rows[num_rows] = d
                num_rows += 1
        for t in range(slots):
            if tracks.live[b, t]:
                columns[num_columns] = t
                num_columns += 1
        table = np.zeros((num_rows, num_columns))
        _score(tracks, settings, b, detections, rows[:num_rows], columns[:num_columns], table)
        mine = np.empty(num_rows, np.int32)
        contested[b] = settle_uncontested(table, mine)
        if contested[b]:
            scores[b] = 0.0
        for i in range(num_rows):
            match[b, rows[i]] = columns[mine[i]] if mine[i] >= 0 else mine[i]
            if contested[b]:
                for j in range(num_columns):
                    scores[b, rows[i], columns[j]] = table[i, j]


@kernel
def _mark_missed(tracks, b, match, missed):
    for t in range(tracks.live.shape[1]):
        missed[t] = tracks.live[b, t]
    for d in range(match.shape[1]):
        if match[b, d] >= 0:
            missed[match[b, d]] = False


@kernel
def _camera_misses(first, last, which, tracks, _, match, pose, view, chance):
    """How surely the camera ought to have seen each track that got no detection, into `chance` [B, T]; 0 of others."""
    missed = np.empty(tracks.live.shape[1], np.bool_)
    for b in range(first, last):
        if which[b]:
            _mark_missed(tracks, b, match, missed)
            for t in range(len(missed)):
                state, body = tracks.state[b, t], tracks.body[b, t]
                chance[b, t] = 0.0
                if missed[t]:
                    chance[b, t] = seen_by_camera(view, b, pose[b], state[0], state[1], body[0], body[1])


@kernel
def _lidar_misses(first, last, which, tracks, _, match, pose, view, chance):
    """The same of the lidar and a track's legs. Beside things legs are often taken for a part of them, so only rays
    that pass where they should be tell much."""
    missed = np.empty(tracks.live.shape[1], np.bool_)
    for b in range(first, last):
        if which[b]:
            _mark_missed(tracks, b, match, missed)
            for t in range(len(missed)):
                chance[b, t] = 0.0
                if missed[t]:
                    reached, through = legs_seen_by_lidar(
                        view, b, pose[b], tracks.state[b, t, 0], tracks.state[b, t, 1]
                    )
                    chance[b, t] = through if through > 0.9 else 0.3 * reached


@inner
def _evidence(settings, confidence):
    """Log-odds that a detection adds."""
    sure = min(max(confidence, 0.01), 0.99)
    return min(max(math.log(sure / (1.0 - sure)) + settings.gain_bias, settings.least_gain), settings.most_gain)


@inner
def _take_in(tracks, settings, b, t, detections, d, from_camera):
    std = max(detections.std_m[b, d], _LEAST_STD_M)
    x, y = detections.pos[b, d, 0], detections.pos[b, d, 1]
    imm_correct(tracks.modes[b, t], tracks.state[b, t], tracks.covariance[b, t], x, y, std)
    for k in range(2):
        size = detections.body[b, d, k]
        if 0.0 < size < 3.0:
            known = tracks.by_camera[b, t]
            tracks.body[b, t, k] += (0.3 if known else 1.0) * (size - tracks.body[b, t, k])
    tracks.by_camera[b, t] |= from_camera
    gain = _evidence(settings, detections.confidence[b, d])
    tracks.existence[b, t] = min(tracks.existence[b, t] + gain, settings.most_evidence)
    tracks.unseen_s[b, t] = 0.0
    tracks.hits[b, t] += 1


@inner
def _begin(tracks, settings, b, detections, d, from_camera, beside_another):
    """A new track, in a free slot or else in that of the least likely unconfirmed track, if that is less likely."""
    std = max(detections.std_m[b, d], _LEAST_STD_M)
    sure = min(max(detections.confidence[b, d], 0.05), 0.95)
    existence = math.log(sure / (1.0 - sure))
    if beside_another:  # it may be a gross error about the other: let it be seen again
        existence = min(existence, 0.0)
    slot, least = -1, np.inf if from_camera else existence
    for t in range(tracks.live.shape[1]):
        worth = tracks.existence[b, t] if tracks.live[b, t] else -np.inf
        if not (tracks.live[b, t] and tracks.confirmed[b, t]) and worth < least:
            slot, least = t, worth
    if slot < 0:
        return
    tracks.state[b, slot, 0], tracks.state[b, slot, 1] = detections.pos[b, d, 0], detections.pos[b, d, 1]
    tracks.state[b, slot, 2] = tracks.state[b, slot, 3] = 0.0
    tracks.covariance[b, slot, 0] = std * std
    tracks.covariance[b, slot, 1] = 0.0
    tracks.covariance[b, slot, 2] = settings.new_speed_std**2
    turning = settings.turns_per_s / (settings.turns_per_s + settings.steadies_per_s)
    imm_begin(tracks.modes[b, slot], tracks.state[b, slot], tracks.covariance[b, slot], turning)
    for k in range(2):
        size = detections.body[b, d, k]
        tracks.body[b, slot, k] = size if 0.0 < size < 3.0 else TYPICAL_BODY[k]
    tracks.existence[b, slot] = existence
    tracks.live[b, slot], tracks.confirmed[b, slot], tracks.by_camera[b, slot] = True, False, from_camera
    tracks.unseen_s[b, slot] = 0.0
    tracks.hits[b, slot] = 1
    tracks.history_count[b, slot] = 0
    tracks.id[b, slot] = tracks.next_id[b]
    tracks.next_id[b] += 1


@inner
def _is_tracked_near(tracks, b, slots, x, y):
    for t in range(slots):
        off_x, off_y = x - tracks.state[b, t, 0], y - tracks.state[b, t, 1]
        if tracks.live[b, t] and off_x * off_x + off_y * off_y < _SAME_PERSON_M**2:
            return True
    return False


@kernel
def _take_in_all(first, last, which, tracks, settings, detections, match, chance, from_camera):
    """Corrects the tracks, counts the misses, begins new tracks."""
    slots, room = tracks.live.shape[1], detections.pos.shape[1]
    for b in range(first, last):
        if not which[b]:
            continue
        for d in range(room):
            if match[b, d] >= 0:
                _take_in(tracks, settings, b, match[b, d], detections, d, from_camera)
        for t in range(slots):
            if tracks.live[b, t] and chance[b, t] > 0.0:
                tracks.existence[b, t] += math.log(1.0 - settings.most_missed * chance[b, t])
        for d in range(room):
            if match[b, d] == NOBODY:
                x, y = detections.pos[b, d, 0], detections.pos[b, d, 1]
                beside_another = _is_tracked_near(tracks, b, slots, x, y)
                if from_camera or not beside_another:
                    _begin(tracks, settings, b, detections, d, from_camera, beside_another)


@inner
def _walks(tracks, settings, b, t):
    """Whether a track has come so far, so straight, that it is no piece of furniture."""
    count = tracks.history_count[b, t]
    if count < 5 or math.hypot(tracks.state[b, t, 2], tracks.state[b, t, 3]) < settings.moving:
        return False
    history, way = tracks.history[b, t], 0.0
    for k in range(HISTORY - count + 1, HISTORY):
        way += math.hypot(history[k, 0] - history[k - 1, 0], history[k, 1] - history[k - 1, 1])
    first = HISTORY - count
    moved = math.hypot(history[HISTORY - 1, 0] - history[first, 0], history[HISTORY - 1, 1] - history[first, 1])
    return moved > settings.moved_m and moved > settings.steady * way


@kernel
def _judge(first, last, which, tracks, settings, dt):
    """Confirms tracks, gives up others, keeps their histories, and notes how people move."""
    for b in range(first, last):
        if not which[b]:
            continue
        tracks.clock_s[b] += dt
        for t in range(tracks.live.shape[1]):
            if not tracks.live[b, t]:
                continue
            believed = tracks.existence[b, t] > settings.least_evidence
            if not believed or not tracks.unseen_s[b, t] < settings.max_unseen_s:
                tracks.live[b, t] = tracks.confirmed[b, t] = False
                continue
            ago = tracks.clock_s[b] - HISTORY_DT_S
            while ago > -1e-6:
                if ago < 1e-6 or tracks.hits[b, t] > 1:  # who has only just been found was nowhere before
                    remember(tracks, b, t, max(ago, 0.0))
                ago -= HISTORY_DT_S
            if tracks.existence[b, t] > settings.confirmed and not tracks.confirmed[b, t]:
                tracks.confirmed[b, t] = tracks.by_camera[b, t] or _walks(tracks, settings, b, t)
            if tracks.confirmed[b, t] and tracks.unseen_s[b, t] == 0.0 and tracks.hits[b, t] > _HITS_TO_KNOW:
                tracks.watched_s[b] += dt
                tracks.turning_s[b] += dt * tracks.modes[b, t, 1, 7]
        while tracks.clock_s[b] > HISTORY_DT_S - 1e-6:
            tracks.clock_s[b] = max(tracks.clock_s[b] - HISTORY_DT_S, 0.0)


class Tracker:
    """The tracks of B worlds, and how they go on."""

    def __init__(self, num_worlds: int, threads: int = 0, settings: TrackerSettings | None = None) -> None:
        """No tracks yet.

        Args:
            num_worlds: B.
            threads: over the worlds; 0 takes all cores.
            settings: what it believes; the shipped ones unless given.

        Raises:
            ValueError: if a setting is not finite, a rate not positive, or there is no world.
        """
        require(num_worlds >= 1, "num_worlds", num_worlds, "at least 1")
        settings = settings or TrackerSettings()
        require(all(map(math.isfinite, settings)), "settings", settings, "finite numbers")
        rates = settings.turns_per_s, settings.steadies_per_s
        require(min(rates) > 0, "turns_per_s, steadies_per_s", rates, "positive")
        self.tracks = allocate_tracks(num_worlds)
        self.threads = threads
        self._settings = TrackerSettings(*map(float, settings))  # one type: compiled once
        self._num_worlds = num_worlds
        self._match = np.empty((num_worlds, MAX_DETECTIONS), np.int32)
        self._scores = np.zeros((num_worlds, MAX_DETECTIONS, MAX_TRACKS))
        self._contested = np.zeros(num_worlds, np.bool_)
        self._chance = np.zeros((num_worlds, MAX_TRACKS))

    def reset(self, which: np.ndarray) -> None:
        """Drops the tracks of the marked worlds (bool [B])."""
        for b in np.flatnonzero(which):
            forget(self.tracks, int(b))

    def update(
        self, pose_odom: np.ndarray, dt_s: float, sightings: Sequence[Sighting], which: np.ndarray | None = None
    ) -> Tracks:
        """Takes in what the sensors found, in the order of `sightings`, `dt_s` after the last update.

        Detections that are not finite, or lie absurdly far, are passed over.

        Args:
            pose_odom: f64 [B, 3] x, y, yaw of the robots in the odometry frame, now.
            dt_s: Seconds.
            sightings: Camera first: a leg beside somebody whom it sees is theirs. A sensor that has nothing new is left
                out, and then misses nobody.
            which: bool [B] worlds to update; all, if left out.

        Returns:
            The tracks, in arrays that the next update writes again.

        Raises:
            ValueError: if `dt_s` is negative or not finite, or an array is of another batch.
        """
        require(math.isfinite(dt_s) and dt_s >= 0.0, "dt_s", dt_s, "0 or more, and finite")
        require(pose_odom.shape == (self._num_worlds, 3), "pose_odom", pose_odom.shape, f"({self._num_worlds}, 3)")
        which = np.ones(self._num_worlds, np.bool_) if which is None else which
        threads = threads_for(which, self.threads)

        def each(function: object, *args: object) -> None:
            for_worlds(function, self._num_worlds, threads, which, self.tracks, self._settings, *args)  # type: ignore[arg-type]

        each(_predict, dt_s)
        for detections, view in sightings:
            from_camera = isinstance(view, DepthView)
            each(_assign, detections, self._match, self._scores, self._contested)
            for b in np.flatnonzero(self._contested):
                settle_contested(self._scores[b], self._match[b])
            each(_camera_misses if from_camera else _lidar_misses, self._match, pose_odom, view, self._chance)
            each(_take_in_all, detections, self._match, self._chance, from_camera)
        each(_judge, dt_s)
        return self.tracks

    def state_dict(self) -> dict[str, np.ndarray]:
        """The tracks of all worlds, as arrays."""
        return {name: value.copy() for name, value in self.tracks._asdict().items()}

    def load_state_dict(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Goes on from a `state_dict` of as many worlds.

        Raises:
            ValueError: if it is of another number of worlds, or of a version that kept less.
        """
        lacking = sorted(set(Tracks._fields) - set(arrays))
        require(not lacking, "what the saved tracks lack", lacking, "nothing: they are of another version")
        saved = len(arrays["next_id"])
        require(saved == self._num_worlds, "saved worlds", saved, str(self._num_worlds))
        for name, array in self.tracks._asdict().items():
            array[:] = arrays[name]
