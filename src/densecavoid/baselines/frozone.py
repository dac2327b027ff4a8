"""Frozone (Sathyamoorthy, Patel, Guan, Manocha, IEEE RA-L 5, 2020) around another navigator: it turns the other's
velocity away from where people ahead would make the robot freeze.

People in a square ahead who stand or come towards the robot may freeze it. Where they will be after `look_ahead_s`
spans a zone; while the robot's way leads into it, the velocity is turned by the least angle that leads past it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float

from densecavoid.baselines.surroundings import PeopleAround
from densecavoid.frames import CameraConfig, Command, LidarConfig, Navigator, RobotConfig, SensorFrame, require
from densecavoid.perception.people_around import People, people_of
from densecavoid.perception.tracks import Tracks
from densecavoid.sim._jit import kernel


@runtime_checkable
class SeesPeople(Protocol):
    """A navigator that tracks people, such as a policy that sees the prediction frame."""

    people_from: str

    @property
    def tracks(self) -> Tracks:
        """Everybody tracked now."""
        ...


@dataclass(frozen=True)
class FrozoneConfig:
    """The zone and the turn. Set by hand, as the paper does not print its own; `python benchmarks/tune_baselines.py
    frozone` looks for better ones on training worlds and places."""

    square_m: float = 3.5
    """People up to so far ahead, and half as far to either side, count (the paper's side of the square)."""
    look_ahead_s: float = 2.0
    """People and robot are moved on by this time."""
    still_m_s: float = 0.1
    """Who is slower stands, and may freeze the robot wherever they look."""
    clearance_m: float = 0.45
    """From the zone to the robot's centre: the collision distance and a step; a person's radius comes on top."""
    max_turn_rad: float = 1.2
    """The greatest angle that is tried."""
    turn_time_s: float = 0.8
    """In which the robot is to turn by the angle."""

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            value = getattr(self, name)
            require(value > 0 and math.isfinite(value), f"FrozoneConfig.{name}", value, "positive")


_ANGLE_STEP = 0.05


@kernel
def _distance_to_segment(x, y, ax, ay, bx, by):
    way_x, way_y = bx - ax, by - ay
    length_2 = way_x * way_x + way_y * way_y
    share = min(max(((x - ax) * way_x + (y - ay) * way_y) / length_2, 0.0), 1.0) if length_2 > 1e-12 else 0.0
    off_x, off_y = x - ax - share * way_x, y - ay - share * way_y
    return math.sqrt(off_x * off_x + off_y * off_y)


@kernel
def distance_to_zone(x, y, hull, count):
    """From a point to the convex polygon of the first `count` corners [n, 2], counter-clockwise; 0 within.

    One corner is a point, two are a segment.
    """
    inside = count >= 3
    nearest = np.inf
    for k in range(count):
        m = (k + 1) % count
        nearest = min(nearest, _distance_to_segment(x, y, hull[k, 0], hull[k, 1], hull[m, 0], hull[m, 1]))
        turn = (hull[m, 0] - hull[k, 0]) * (y - hull[k, 1]) - (hull[m, 1] - hull[k, 1]) * (x - hull[k, 0])
        inside = inside and turn >= 0.0
    return 0.0 if inside else nearest


@kernel
def convex_hull(points, count, hull):
    """Writes the hull of the first `count` points, counter-clockwise, into `hull`; how many corners it has (Jarvis)."""
    if count <= 1:
        hull[:count] = points[:count]
        return count
    first = 0
    for k in range(1, count):
        if points[k, 0] < points[first, 0] or (points[k, 0] == points[first, 0] and points[k, 1] < points[first, 1]):
            first = k
    corner, size = first, 0
    while size < count:
        hull[size] = points[corner]
        size += 1
        following = 0 if corner != 0 else 1
        for k in range(count):
            if k == corner:
                continue
            ax, ay = points[following, 0] - points[corner, 0], points[following, 1] - points[corner, 1]
            bx, by = points[k, 0] - points[corner, 0], points[k, 1] - points[corner, 1]
            turn = ax * by - ay * bx
            if turn < 0.0 or (turn == 0.0 and bx * bx + by * by > ax * ax + ay * ay):
                following = k
        corner = following
        if corner == first:
            break
    return size


@kernel
def least_turns(points, count, radius, speed, seconds, clearance, max_turn, step, out):
    """The least angle (rad, left positive) by which each robot's straight way passes its zone, into `out` [B].

    Args:
        points: f64 [B, P, 2] the zone's people where they will be, in the robot's frame; count: i64 [B].
        radius: f64 [B] the largest of their bodies'.
        speed: f64 [B] of the robot, m/s.
        seconds: how far its way is looked at.
        step: between the angles that are tried; NaN is written where none up to `max_turn` leads past.
    """
    hull = np.empty((points.shape[1], 2))
    for b in range(points.shape[0]):
        out[b] = 0.0
        corners = convex_hull(points[b], count[b], hull)
        if corners == 0:
            continue
        need = clearance + radius[b]
        # Who is too near already must come no nearer.
        need = min(need, distance_to_zone(0.0, 0.0, hull, corners) - 0.01)
        reach = speed[b] * seconds
        out[b] = np.nan
        for k in range(int(max_turn / step) * 2 + 1):
            angle = step * ((k + 1) // 2) * (1.0 if k % 2 == 0 else -1.0)
            least = np.inf
            for m in range(1, 9):
                x, y = reach * m / 8.0 * math.cos(angle), reach * m / 8.0 * math.sin(angle)
                least = min(least, distance_to_zone(x, y, hull, corners))
            if least >= need:
                out[b] = angle
                break


class Frozone:
    """Satisfies `frames.Navigator`. Sees what `inner` sees, and tracked people."""

    name = "frozone"

    def __init__(
        self,
        inner: Navigator,
        robot: RobotConfig = RobotConfig(),
        lidar: LidarConfig = LidarConfig(),
        camera: CameraConfig = CameraConfig(),
        config: FrozoneConfig | None = None,
    ) -> None:
        self.inner = inner
        self.robot = robot
        self.config = config or FrozoneConfig()
        # Who finds people itself need not be asked twice.
        self._sees = isinstance(inner, SeesPeople) and inner.people_from == "detector"
        self._people = PeopleAround("tracks", lidar, camera)

    @property
    def privileged(self) -> bool:
        """As the navigator inside is, or the source of people."""
        return self.inner.privileged or self._people.privileged

    @property
    def policy(self) -> object:
        """Of the navigator inside, for the tables; None if it has none."""
        return getattr(self.inner, "policy", None)

    def reset(self, which: Bool[np.ndarray, "B"]) -> None:
        """Forgets the marked worlds."""
        self.inner.reset(which)
        self._people.reset(which)

    def act(self, frame: SensorFrame) -> Command:
        """The inner command, turned away from the zone where its way leads into it."""
        config, limit = self.config, self.robot.max_angular_velocity
        command = self.inner.act(frame)
        linear = command.linear_velocity.astype(np.float64)
        zone, count, radius = self._zone(self._see(frame))
        turn = np.zeros(frame.num_worlds)
        least_turns(
            zone,
            count,
            radius,
            linear,
            config.look_ahead_s,
            config.clearance_m,
            config.max_turn_rad,
            _ANGLE_STEP,
            turn,
        )
        stuck = np.isnan(turn)
        angular = np.where(turn == 0.0, command.angular_velocity, np.clip(turn / config.turn_time_s, -limit, limit))
        # No angle leads past: as the inner navigator wants, which may be to wait.
        angular = np.where(stuck, command.angular_velocity, angular)
        return Command(command.linear_velocity, angular.astype(np.float32))

    def _see(self, frame: SensorFrame) -> People:
        if self._sees:
            assert isinstance(self.inner, SeesPeople)
            return people_of(self.inner.tracks, frame)
        return self._people.see(frame)

    def _zone(self, people: People) -> tuple[Float[np.ndarray, "B P 2"], np.ndarray, Float[np.ndarray, "B"]]:
        """Corners that the zone is the hull of: people who may freeze the robot, where they will be; how many they are
        (they come first), and the largest radius."""
        config = self.config
        x, y = people.pos_r[..., 0], people.pos_r[..., 1]
        ahead = (x > 0) & (x < config.square_m) & (np.abs(y) < config.square_m / 2)
        speed = np.linalg.norm(people.vel_r, axis=-1)
        comes = (people.vel_r * people.pos_r).sum(axis=-1) < 0
        freezes = people.there & ahead & (comes | (speed < config.still_m_s))
        later = people.pos_r + config.look_ahead_s * people.vel_r
        # People do not come through the robot: at the nearest they stand before it.
        later[..., 0] = np.maximum(later[..., 0], np.minimum(x, self.robot.radius_m))
        order = np.argsort(~freezes, axis=1, kind="stable")
        zone = np.take_along_axis(later, order[..., None], axis=1)
        radius = np.where(freezes, people.radius_m, 0.0).max(axis=1)
        return zone, freezes.sum(axis=1), radius
