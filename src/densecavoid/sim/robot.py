"""The differential-drive robot: how a command becomes motion, with ideal wheels or with Kobuki's limits."""

from __future__ import annotations

import math
from typing import NamedTuple

from densecavoid.sim._jit import inner


class Robot(NamedTuple):
    """What the kernels know of the robot."""

    dynamic: bool
    """Whether its wheels have limits and it obeys one control step late."""
    max_linear_acc: float
    max_angular_acc: float
    radius: float
    height: float


@inner
def limit_change(value, target, max_change):
    """`target`, or as near to it as `max_change` from `value` allows."""
    return min(max(target, value - max_change), value + max_change)


@inner
def drive(pose, linear, angular, dt):
    """Moves `pose` (x, y, yaw) along the exact arc of constant velocities for `dt` seconds."""
    turned = angular * dt
    half = 0.5 * turned
    # The chord of an arc is its length times sin(half)/half, in the direction of the mean heading.
    chord = linear * dt * (math.sin(half) / half if abs(half) > 1e-6 else 1.0)
    pose[0] += chord * math.cos(pose[2] + half)
    pose[1] += chord * math.sin(pose[2] + half)
    pose[2] = (pose[2] + turned + math.pi) % (2.0 * math.pi) - math.pi
