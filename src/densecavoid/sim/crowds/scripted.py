"""Where the paper's people want to go: to places of their own, without a thought of anybody."""

from __future__ import annotations

import math

import numpy as np

from densecavoid.sim._jit import inner, kernel
from densecavoid.sim.people import ABSENT, CIRCULATING, TRAVERSING, WANDERING

_ARRIVED_M = 0.4
_ROOM_TO_ENTER_M = 0.1  # between bodies, when somebody enters


@kernel
def uniform(random, b):
    """A number in [0, 1) from world b's own generator (splitmix64, Steele, Lea, Flood 2014)."""
    random[b] += np.uint64(0x9E3779B97F4A7C15)
    z = random[b]
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return float(z >> np.uint64(11)) / 9007199254740992.0


@inner
def _next_leg(state, b, i, arrived):
    """Sends person i on along the net, by any link but the one they came by, or back where they came from."""
    origin, here = state.leg[b, i, 0], state.leg[b, i, 1]
    target = origin
    if arrived:
        count = 0
        for k in range(state.net_links.shape[2]):
            link = state.net_links[b, here, k]
            if link >= 0 and link != origin:
                count += 1
        chosen = int(uniform(state.random, b) * count)
        for k in range(state.net_links.shape[2]):
            link = state.net_links[b, here, k]
            if link >= 0 and link != origin:
                if chosen == 0:
                    target = link
                chosen -= 1
    state.leg[b, i, 0], state.leg[b, i, 1] = here, target
    away = state.net_places[b, target, 2] * math.sqrt(uniform(state.random, b))
    angle = 2.0 * math.pi * uniform(state.random, b)
    state.person_goal[b, i, 0] = state.net_places[b, target, 0] + away * math.cos(angle)
    state.person_goal[b, i, 1] = state.net_places[b, target, 1] + away * math.sin(angle)


@inner
def _enter_again(state, b, i, robot_radius):
    """Lets person i, who has left, enter where they once began, if there is room: another person, for all who watch."""
    x, y, radius = state.entrance[b, i, 0], state.entrance[b, i, 1], state.radius[b, i]
    for j in range(-1, state.pos.shape[1]):
        if j < 0:
            off_x, off_y, reach = state.robot_pose[b, 0] - x, state.robot_pose[b, 1] - y, 2.0 * robot_radius
        else:
            off_x, off_y, reach = state.pos[b, j, 0] - x, state.pos[b, j, 1] - y, state.radius[b, j]
        reach += radius + _ROOM_TO_ENTER_M
        if off_x * off_x + off_y * off_y < reach * reach and (j < 0 or state.behaviour[b, j] != ABSENT):
            return
    heading = math.atan2(state.person_goal[b, i, 1] - y, state.person_goal[b, i, 0] - x)
    state.pos[b, i, 0], state.pos[b, i, 1], state.heading[b, i] = x, y, heading
    state.vel[b, i, 0] = state.preferred_speed[b, i] * math.cos(heading)
    state.vel[b, i, 1] = state.preferred_speed[b, i] * math.sin(heading)
    state.behaviour[b, i] = CIRCULATING
    state.person_id[b, i] = state.next_id[b]
    state.next_id[b] += 1


@inner
def intend_scripted(state, b, intended, robot_radius, dt):
    """Writes where the people of world b who walk by themselves want to go, as velocities [P, 2]."""
    for i in range(state.pos.shape[1]):
        behaviour = state.behaviour[b, i]
        if behaviour == ABSENT and not np.isnan(state.entrance[b, i, 0]):
            _enter_again(state, b, i, robot_radius)
            behaviour = state.behaviour[b, i]
        if behaviour != WANDERING and behaviour != TRAVERSING and behaviour != CIRCULATING:
            continue
        off_x = state.person_goal[b, i, 0] - state.pos[b, i, 0]
        off_y = state.person_goal[b, i, 1] - state.pos[b, i, 1]
        distance = math.sqrt(off_x * off_x + off_y * off_y)
        if behaviour != WANDERING and distance < _ARRIVED_M:
            state.behaviour[b, i] = ABSENT
            continue
        if behaviour == WANDERING and (distance < _ARRIVED_M or uniform(state.random, b) < state.change_rate[b] * dt):
            if state.leg[b, i, 1] >= 0:
                _next_leg(state, b, i, distance < _ARRIVED_M)
            else:
                area = state.wander_area[b]
                state.person_goal[b, i, 0] = area[0] + (area[2] - area[0]) * uniform(state.random, b)
                state.person_goal[b, i, 1] = area[1] + (area[3] - area[1]) * uniform(state.random, b)
        scale = state.preferred_speed[b, i] / max(distance, 1e-6)
        intended[i, 0], intended[i, 1] = off_x * scale, off_y * scale
