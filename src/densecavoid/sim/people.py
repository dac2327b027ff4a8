"""People's bodies: how big they are, how they step, and the cylinders that rays and collisions meet.

In plan view a body is a stadium, shoulders wider than deep: all within `half_depth` of a line across the heading. A
person is two legs, two halves of a trunk, two arms and a head, all upright cylinders. Trunk and arms fill the outline
and never leave it; the legs step beyond it, ahead and behind, as legs do.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from densecavoid.sim._jit import inner, kernel
from densecavoid.sim.geometry import CYL_RADIUS, CYL_X, CYL_Y, CYL_Z_MAX, CYL_Z_MIN

LEFT_LEG, RIGHT_LEG, LEFT_TRUNK, RIGHT_TRUNK, LEFT_ARM, RIGHT_ARM, HEAD = range(7)
PARTS = 7
"""Cylinders a person; the two halves of the trunk overlap, the neck belongs to the head."""

ABSENT, STANDING, WANDERING, TRAVERSING, RECORDED, CIRCULATING = range(6)
"""What a person does: is not there; stands; walks to random places; walks to one and leaves; follows a recording; walks
to one and enters again where they began."""

IGNORE, YIELD, BLOCK = range(3)
"""What a person thinks of the robot: nothing; makes way for it; is curious, and stops in front of it."""

STEP_OVER_M = 0.2
"""What is no higher (kerbs, ramps, steps) people walk over."""
WALK_UNDER_M = 2.0
"""What begins above this (lamps, crowns of trees) they walk under."""

# Heights as shares of the body's (Drillis and Contini, Body Segment Parameters, 1966; Winter, Biomechanics and Motor
# Control of Human Movement, fig. 4.1): crotch .47, shoulder .82; of a hanging arm, wrist .49 and finger tips .38.
_CROTCH_HEIGHT = 0.47
_SHOULDER_HEIGHT = 0.82
_HAND_HEIGHT = 0.42
_LOWEST_M = 0.75  # trunk and hands reach down to this at least: nobody is hollow to a robot of the default .8 m

# Sideways from the body's axis, and radii, as shares of the half shoulder width. Legs so thick (.14 m, in trousers)
# and so far apart (.15 m walking, .23 m standing) look to a lidar as real ones do: benchmarks/legs.py.
_LEG_RADIUS = 0.27
_LEG_ASIDE_WALKING = 0.30
_LEG_ASIDE_STANDING = 0.45
_WALKING_SPEED = 0.5  # m/s; slower people set their feet farther apart
_TRUNK_ASIDE = 0.15
_ARM_RADIUS = 0.19
_HEAD_RADIUS_M = 0.08

_SHIN_SWING = 0.58
"""A shin's swing as a share of the foot's. A straight leg of .85 m would give .69 at .26 m; bent knees take their part,
and with .58 legs are as far apart as in real scans."""
_ARM_SWING = 0.6  # of an arm's room within the outline, when shins swing this far (1.3 m/s)
_FULL_SWING_M = 0.21


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


@inner
def _place(part, x, y, radius, z_min, z_max):
    part[CYL_X], part[CYL_Y], part[CYL_RADIUS] = x, y, radius
    part[CYL_Z_MIN], part[CYL_Z_MAX] = z_min, z_max


@kernel
def place_body(parts, pos_x, pos_y, heading, speed, phase, radius, height):
    """Writes one person's cylinders into `parts` [PARTS, 5]."""
    ahead_x, ahead_y = math.cos(heading), math.sin(heading)
    depth, arm_radius = half_depth(radius), _ARM_RADIUS * radius
    reach = 0.5 * _SHIN_SWING * step_length(speed)
    stride = math.sin(phase)
    # An arm swings against the leg of its side, along the round end of the outline, which it touches from within.
    room = depth - arm_radius
    arm_stride = min(1.0, reach / _FULL_SWING_M) * _ARM_SWING * stride
    arm_aside = radius - depth + room * math.sqrt(1.0 - arm_stride * arm_stride)
    leg_aside = _LEG_ASIDE_STANDING + (_LEG_ASIDE_WALKING - _LEG_ASIDE_STANDING) * min(1.0, speed / _WALKING_SPEED)
    low, shoulder = min(_CROTCH_HEIGHT * height, _LOWEST_M), _SHOULDER_HEIGHT * height
    hand = min(_HAND_HEIGHT * height, _LOWEST_M)
    for side in range(2):
        left = 1.0 - 2.0 * side
        ahead, aside = left * reach * stride, left * leg_aside * radius
        x, y = pos_x + ahead_x * ahead - ahead_y * aside, pos_y + ahead_y * ahead + ahead_x * aside
        _place(parts[LEFT_LEG + side], x, y, _LEG_RADIUS * radius, 0.0, low)
        aside = left * _TRUNK_ASIDE * radius
        _place(parts[LEFT_TRUNK + side], pos_x - ahead_y * aside, pos_y + ahead_x * aside, depth, low, shoulder)
        ahead, aside = -left * room * arm_stride, left * arm_aside
        x, y = pos_x + ahead_x * ahead - ahead_y * aside, pos_y + ahead_y * ahead + ahead_x * aside
        _place(parts[LEFT_ARM + side], x, y, arm_radius, hand, shoulder)
    _place(parts[HEAD], pos_x, pos_y, _HEAD_RADIUS_M, shoulder, height)


@kernel
def remove_body(parts):
    """Takes one person's cylinders out of the world: nothing meets a cylinder without radius."""
    parts[:, CYL_RADIUS] = 0.0
