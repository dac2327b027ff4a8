"""What a curious person does: steps into the robot's way, stops and looks at it, until they have had enough."""

from __future__ import annotations

import math

from densecavoid.sim._jit import inner
from densecavoid.sim.crowds.neighbours import walks
from densecavoid.sim.crowds.steering import turned
from densecavoid.sim.people import BLOCK, YIELD

_NOTICE_M = 4.0
_STAND_OFF_M = 0.7  # from the robot's hull to where they stop
_SLOW_DOWN_S = 0.5  # in which they walk what is left to that place


@inner
def step_in_the_way(state, b, intended, robot_radius, dt):
    """Lets the curious people of world b, if the robot is near, want to be in front of it."""
    pose = state.robot_pose[b]
    for i in range(state.pos.shape[1]):
        if state.attitude[b, i] != BLOCK or not walks(state.behaviour[b, i]):
            continue
        off_x, off_y = pose[0] - state.pos[b, i, 0], pose[1] - state.pos[b, i, 1]
        if off_x * off_x + off_y * off_y > _NOTICE_M * _NOTICE_M:
            continue
        ahead = robot_radius + _STAND_OFF_M + state.radius[b, i]
        to_x, to_y = off_x + ahead * math.cos(pose[2]), off_y + ahead * math.sin(pose[2])
        distance = math.sqrt(to_x * to_x + to_y * to_y)
        speed = min(distance / _SLOW_DOWN_S, state.preferred_speed[b, i])
        intended[i, 0] = speed * to_x / max(distance, 1e-6)
        intended[i, 1] = speed * to_y / max(distance, 1e-6)
        if distance < 0.5:
            state.heading[b, i] = turned(state.heading[b, i], math.atan2(off_y, off_x), 1.0, dt)
        state.curious_s[b, i] -= dt
        if state.curious_s[b, i] <= 0.0:
            state.attitude[b, i] = YIELD
