"""People who walk as they were recorded: to the letter, or with the recorded way as an intention to return to."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from densecavoid.sim._jit import inner
from densecavoid.sim.crowds.steering import walk
from densecavoid.sim.people import ABSENT, RECORDED

_RETURN_S = 1.0  # in which a person displaced from the recorded way comes back to it


class Recordings(NamedTuple):
    """All recordings of a simulator, one after another, at the simulator's time step."""

    first_step: np.ndarray  # i64 [R] index into frame_start of each recording's first time step
    num_steps: np.ndarray  # i64 [R]
    first_person: np.ndarray  # i64 [R]
    frame_start: np.ndarray  # i64 [steps + 1] first row of each time step
    rows: np.ndarray  # f32 [N, 4] x, y, vx, vy
    person: np.ndarray  # i32 [N] within the recording
    radius: np.ndarray  # f32 [people]
    height: np.ndarray  # f32 [people]


def no_recordings() -> Recordings:
    """The empty set, so that kernels always get the same types."""
    whole, real = np.zeros(0, np.int64), np.zeros(0, np.float32)
    return Recordings(
        whole, whole, whole, np.zeros(1, np.int64), np.zeros((0, 4), np.float32), np.zeros(0, np.int32), real, real
    )


@inner
def _slot_of(state, b, person):
    """The slot in which a person is, or a free one, or -1 if all are taken."""
    free = -1
    for i in range(state.pos.shape[1]):
        if state.behaviour[b, i] == RECORDED and state.person_id[b, i] == person:
            return i
        if free < 0 and state.behaviour[b, i] == ABSENT:
            free = i
    return free


@inner
def follow_recording(state, b, recordings, sub_step, reactive, intended, dt):
    """Brings in and takes out the people of the recording in world b, and moves them or says where they want to go.

    Args:
        sub_step: physics steps since the start of the episode.
        reactive: False: people stand where they were recorded. True: `intended` [P, 2] gets the velocity that follows
            the recorded way.
    """
    k = state.recording[b]
    step = min(state.recording_step[b] + sub_step, recordings.num_steps[k] - 1)
    start = recordings.frame_start[recordings.first_step[k] + step]
    stop = recordings.frame_start[recordings.first_step[k] + step + 1]
    if step == recordings.num_steps[k] - 1:
        stop = start  # the recording is over: nobody is left
    for i in range(state.pos.shape[1]):
        if state.behaviour[b, i] != RECORDED:
            continue
        present = False
        for row in range(start, stop):
            present = present or recordings.person[row] == state.person_id[b, i]
        if not present:
            state.behaviour[b, i] = ABSENT
            state.person_id[b, i] = -1
    for row in range(start, stop):
        person = recordings.person[row]
        i = _slot_of(state, b, person)
        x, y = recordings.rows[row, 0], recordings.rows[row, 1]
        vx, vy = recordings.rows[row, 2], recordings.rows[row, 3]
        entering = state.behaviour[b, i] == ABSENT
        if entering:
            state.behaviour[b, i] = RECORDED
            state.person_id[b, i] = person
            state.radius[b, i] = recordings.radius[recordings.first_person[k] + person]
            state.height[b, i] = recordings.height[recordings.first_person[k] + person]
            state.heading[b, i] = math.atan2(vy, vx)
            state.phase[b, i] = (2.399963 * person) % (2.0 * math.pi)  # golden angle: strides out of step
        if entering or not reactive:
            state.pos[b, i, 0], state.pos[b, i, 1] = x, y
            state.vel[b, i, 0], state.vel[b, i, 1] = vx, vy
        if reactive:
            speed = math.sqrt(vx * vx + vy * vy)
            state.preferred_speed[b, i] = max(speed, 0.5)
            intended[i, 0] = vx + (x - state.pos[b, i, 0]) / _RETURN_S
            intended[i, 1] = vy + (y - state.pos[b, i, 1]) / _RETURN_S
        else:
            state.heading[b, i], state.phase[b, i] = walk(vx, vy, state.heading[b, i], state.phase[b, i], 0.0, dt)
