"""People's bodies: how big they are, how they step, and the cylinders that rays and collisions meet.

A person is two legs, a trunk and a head, all upright cylinders. The trunk is as wide as the body radius and the legs
swing inside its outline, so in plan view the body is a disc and the nearest surface is the same for rays and wheels.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from densecavoid.sim._jit import kernel
from densecavoid.sim.geometry import CYL_RADIUS, CYL_X, CYL_Y, CYL_Z_MAX, CYL_Z_MIN

PARTS = 4
"""Cylinders a person: left leg, right leg, trunk, head."""

ABSENT, STANDING, WANDERING, TRAVERSING, RECORDED, CIRCULATING = range(6)
"""What a person does: is not there; stands; walks to random places; walks to one and leaves; follows a recording; walks
to one and enters again where they began."""

IGNORE, YIELD, BLOCK = range(3)
"""What a person thinks of the robot: nothing; makes way for it; is curious, and stops in front of it."""

_LEG_RADIUS_M = 0.065
_HEAD_RADIUS_M = 0.09
_LEG_SPACING_M = 0.09  # from the body's axis, sideways
_HIP_HEIGHT = 0.40  # fractions of body height
_NECK_HEIGHT = 0.84


def sample_bodies(rng: np.random.Generator, count: int) -> tuple[Float[np.ndarray, "P"], Float[np.ndarray, "P"]]:
    """Body radius N(.255, .035) clipped to [.19, .33] m and height N(1.71, .09) clipped to [1.45, 1.98] m (adults)."""
    radius_m = np.clip(rng.normal(0.255, 0.035, count), 0.19, 0.33)
    height_m = np.clip(rng.normal(1.71, 0.09, count), 1.45, 1.98)
    return radius_m, height_m


@kernel
def half_depth(radius):
    """Half of a body's depth, front to back, of one whose half shoulder width is `radius`: .28 m of .51 m (clothed
    adults; shoulders are wider than deep)."""
    return 0.55 * radius


@kernel
def step_length(speed):
    """Metres a step at a walking speed in m/s: .60 v^.6, within 3 % of the measured .40, .56, .73, .85 m at
    .5, .9, 1.3, 1.75 m/s (gait laboratory averages)."""
    return 0.603 * speed**0.6


@kernel
def advance_gait(phase, speed, dt):
    """The stride's phase (rad) after `dt` seconds: two steps a stride, v / step length steps a second."""
    if speed < 0.05:
        return phase
    return (phase + math.pi * speed / step_length(speed) * dt) % (2.0 * math.pi)


@kernel
def place_body(parts, pos_x, pos_y, heading, speed, phase, radius, height):
    """Writes one person's cylinders into `parts` [PARTS, 5]."""
    forward_x, forward_y = math.cos(heading), math.sin(heading)
    # A shin's swing is .69 of the foot's (a lidar at .26 m on a leg of .85 m), kept inside the body's outline.
    room = radius - _LEG_RADIUS_M
    spacing = min(_LEG_SPACING_M, 0.7 * room)
    reach = math.sqrt(room * room - spacing * spacing)
    swing = min(0.69 * 0.5 * step_length(max(speed, 1e-6)), reach) * math.sin(phase)
    for leg in range(2):
        side = spacing if leg == 0 else -spacing
        ahead = swing if leg == 0 else -swing
        parts[leg, CYL_X] = pos_x + forward_x * ahead - forward_y * side
        parts[leg, CYL_Y] = pos_y + forward_y * ahead + forward_x * side
        parts[leg, CYL_RADIUS] = _LEG_RADIUS_M
        parts[leg, CYL_Z_MIN] = 0.0
        parts[leg, CYL_Z_MAX] = _HIP_HEIGHT * height
    for part in range(2, PARTS):
        parts[part, CYL_X] = pos_x
        parts[part, CYL_Y] = pos_y
    parts[2, CYL_RADIUS] = radius
    parts[2, CYL_Z_MIN] = min(_HIP_HEIGHT * height, 0.75)
    parts[2, CYL_Z_MAX] = _NECK_HEIGHT * height
    parts[3, CYL_RADIUS] = _HEAD_RADIUS_M
    parts[3, CYL_Z_MIN] = _NECK_HEIGHT * height
    parts[3, CYL_Z_MAX] = height


@kernel
def remove_body(parts):
    """Takes one person's cylinders out of the world: nothing meets a cylinder without radius."""
    parts[:, CYL_RADIUS] = 0.0
