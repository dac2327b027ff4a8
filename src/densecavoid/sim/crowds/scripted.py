"""The paper's people: they walk to places of their own and do not think of the robot (unless told to notice it)."""

from __future__ import annotations

import math

import numpy as np

from densecavoid.sim._jit import inner, kernel
from densecavoid.sim.people import ABSENT, TRAVERSING, WANDERING

_ARRIVED_M = 0.4


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
def intend_scripted(state, b, intended, dt):
    """Writes where wanderers and traversers of world b want to go, as velocities [P, 2]."""
    for i in range(state.pos.shape[1]):
        behaviour = state.behaviour[b, i]
        if behaviour != WANDERING and behaviour != TRAVERSING:
            continue
        off_x = state.person_goal[b, i, 0] - state.pos[b, i, 0]
        off_y = state.person_goal[b, i, 1] - state.pos[b, i, 1]
        distance = math.sqrt(off_x * off_x + off_y * off_y)
        if behaviour == TRAVERSING and distance < _ARRIVED_M:
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
