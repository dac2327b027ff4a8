"""How fast the robot may go towards things and predicted people: it must be able to stand before it meets them.

The robot moves on along the command's arc for the time it takes to react and then brakes; people move on at constant
velocity, with a margin that grows. The fastest command on that arc that ends without contact is allowed (passive
safety: whoever still meets the robot walked into it). On top, as in Nav2's collision monitor, a command whose contact
with a thing is nearer than `time_before_collision_s` is slowed down in proportion.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from densecavoid.safety.config import SafetyConfig
from densecavoid.safety.shapes import in_polygon

_STEP_S = 0.05
_FACTORS = np.linspace(0.0, 1.0, 11)
_MAX_POINTS = 256
_BODY_POINTS_M = 0.15
"""Returns this near to a tracked body are its own."""


class PeopleNear(NamedTuple):
    """People as the filter sees them: in the robot's axes, velocities over ground."""

    pos_r: Float[np.ndarray, "people 2"]
    vel_r: Float[np.ndarray, "people 2"]
    radius_m: Float[np.ndarray, "people"]


NOBODY = PeopleNear(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0))


class Allowed(NamedTuple):
    """The greatest factor on the command, and what asks for it (empty where nothing does)."""

    factor: float
    reason: str


def arc(
    linear: Float[np.ndarray, "*n"], curvature: float, angular: Float[np.ndarray, "*n"]
) -> tuple[Float[np.ndarray, "*n 2"], Float[np.ndarray, "*n"]]:
    """Where the robot is after a way of length `linear` (m) on an arc, or a turn by `angular` (rad) in place.

    Returns:
        places and headings, from the origin looking along x.
    """
    heading = linear * curvature if math.isfinite(curvature) else angular
    half = 0.5 * heading
    chord = linear * np.sinc(half / np.pi)
    return np.stack([chord * np.cos(half), chord * np.sin(half)], axis=-1), heading


def _drop_bodies(points: Float[np.ndarray, "n 2"], people: PeopleNear) -> Float[np.ndarray, "m 2"]:
    if len(people.pos_r) == 0 or len(points) == 0:
        return points
    apart = np.linalg.norm(points[:, None] - people.pos_r[None], axis=-1)
    return points[~(apart < people.radius_m + _BODY_POINTS_M).any(axis=1)]


def allowed_factor(
    linear: float,
    angular: float,
    points: Float[np.ndarray, "n 2"],
    people: PeopleNear,
    config: SafetyConfig,
) -> Allowed:
    """The greatest factor in [0, 1] on the command (m/s, rad/s) that keeps it safe.

    Args:
        linear, angular: the command.
        points: returns of all scans, robot frame.
        people: tracked people; those faster than `max_person_speed` are slowed to it.
        config: outline, braking, margins.
    """
    approach = config.approach
    if linear == 0.0 and (angular == 0.0 or not config.footprint):
        return Allowed(1.0, "")  # a disc that turns in place sweeps nothing
    speed = abs(linear)
    horizon_s = max(approach.reaction_s + speed / config.braking, approach.time_before_collision_s)
    time = np.arange(0.0, horizon_s + _STEP_S, _STEP_S)
    curvature = angular / linear if linear != 0.0 else math.inf
    at, heading = arc(linear * time, curvature, angular * time)
    reach = speed * horizon_s + outline_m(config) + approach.margin_m
    points = _near(_drop_bodies(points, people), reach)
    people = _capped(people, reach + horizon_s * approach.max_person_speed, approach.max_person_speed)

    factor, reason = 1.0, ""
    contact = _first_contact(points, time, at, heading, config)
    if contact is not None:
        # The way left, and the speed from which reaction and braking take that way: v reaction + v2 / 2 a = way.
        way = speed * max(contact - _STEP_S, 0.0)
        if speed > 0.0:
            grip, brake = approach.reaction_s, config.braking
            factor = min(1.0, brake * (math.sqrt(grip * grip + 2.0 * way / brake) - grip) / speed)
        else:
            factor = 0.0 if contact <= approach.reaction_s + _STEP_S else 1.0
        reason = "approach: obstacle" if factor < 1.0 else ""
    if len(people.pos_r):
        ladder = _past_people(linear, curvature, angular, people, config)
        if ladder < factor:
            factor, reason = ladder, "approach: person"
    if contact is not None and contact < factor * approach.time_before_collision_s:
        factor, reason = contact / approach.time_before_collision_s, f"approach: contact in {contact:.2f} s"
    return Allowed(factor, reason)


def outline_m(config: SafetyConfig) -> float:
    """Greatest distance of the robot's outline from its centre."""
    return max((math.hypot(*corner) for corner in config.footprint), default=config.radius_m)


def _near(points: Float[np.ndarray, "n 2"], reach: float) -> Float[np.ndarray, "m 2"]:
    distance = np.hypot(points[:, 0], points[:, 1])
    points, distance = points[distance < reach], distance[distance < reach]
    return points if len(points) <= _MAX_POINTS else points[np.argpartition(distance, _MAX_POINTS)[:_MAX_POINTS]]


def _capped(people: PeopleNear, reach: float, max_speed: float) -> PeopleNear:
    near = np.hypot(people.pos_r[:, 0], people.pos_r[:, 1]) < reach + people.radius_m + 1.0
    vel = people.vel_r[near]
    speed = np.hypot(vel[:, 0], vel[:, 1])[:, None]
    return PeopleNear(
        people.pos_r[near], vel * np.minimum(1.0, max_speed / np.maximum(speed, 1e-9)), people.radius_m[near]
    )


def _first_contact(
    points: Float[np.ndarray, "n 2"],
    time: Float[np.ndarray, "times"],
    at: Float[np.ndarray, "times 2"],
    heading: Float[np.ndarray, "times"],
    config: SafetyConfig,
) -> float | None:
    """When the robot, on its way at the command's speed, meets enough returns; None if it does not. A disc may leave
    whatever it is already too near to, only not near it."""
    approach = config.approach
    if len(points) < approach.min_points:
        return None
    offset = points - at[:, None, :]
    distance = np.hypot(offset[..., 0], offset[..., 1])
    if config.footprint:
        cos, sin = np.cos(heading)[:, None], np.sin(heading)[:, None]
        ahead = cos * offset[..., 0] + sin * offset[..., 1]
        left = cos * offset[..., 1] - sin * offset[..., 0]
        corners = np.array(config.footprint)
        # Pushed out from the centre: at least the margin beyond every corner, and less than it beyond the sides.
        grown = corners * (1.0 + approach.margin_m / np.hypot(corners[:, 0], corners[:, 1]).clip(1e-6))[:, None]
        meets = in_polygon(np.stack([ahead, left], axis=-1), grown)
    else:
        meets = (distance < config.radius_m + approach.margin_m) & (distance < distance[0] - 1e-3)
    enough = np.count_nonzero(meets, axis=1) >= approach.min_points
    return float(time[np.argmax(enough)]) if enough.any() else None


def _past_people(linear: float, curvature: float, angular: float, people: PeopleNear, config: SafetyConfig) -> float:
    """The greatest factor with which the robot stands before it meets anybody."""
    approach, speed = config.approach, abs(linear)
    time = np.arange(0.0, approach.reaction_s + speed / config.braking + 2 * _STEP_S, _STEP_S)
    start = _FACTORS[:, None] * speed
    # Way of each factor: at its speed until the brakes grip, then slowing down until it stands. [factors, times]
    stands = start / config.braking
    grip = np.clip(time - approach.reaction_s, 0.0, stands)
    way = start * np.minimum(time, approach.reaction_s) + start * grip - 0.5 * config.braking * grip**2
    at, _ = arc(math.copysign(1.0, linear) * way, curvature, _FACTORS[:, None] * angular * time)
    moving = time <= approach.reaction_s + stands + _STEP_S
    unsafe = np.flatnonzero((_meets_people(time, at, people, config) & moving)[1:].any(axis=1))
    # The first unsafe rung ends the ladder: a faster way past somebody is not this filter's to choose.
    return float(_FACTORS[unsafe[0]]) if len(unsafe) else 1.0


def _meets_people(
    time: Float[np.ndarray, "times"],
    at: Float[np.ndarray, "factors times 2"],
    people: PeopleNear,
    config: SafetyConfig,
) -> Bool[np.ndarray, "factors times"]:
    """Whether somebody meets the robot, that would move then. Whoever is too near already may be left, not neared."""
    approach = config.approach
    then = people.pos_r + time[:, None, None] * people.vel_r
    near = outline_m(config) + people.radius_m + approach.person_margin_m
    offset = then - at[:, :, None, :]
    distance = np.hypot(offset[..., 0], offset[..., 1])
    now = np.hypot(people.pos_r[:, 0], people.pos_r[:, 1])
    leaves = (now < near) & (distance > now)
    return np.any((distance < near + approach.person_speed_error * time[:, None]) & ~leaves, axis=-1)
