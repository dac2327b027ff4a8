"""The filter between whoever drives and the wheels. It only ever slows down, stops, or turns in place out of a freeze.

Of all that it knows (limits, zones, approach, missing data) the strictest wins. It is asked at a steady rate, not only
when a command arrives, so that it also notices a controller that has died. It knows no policy and no ROS.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from densecavoid.frames import choose, require
from densecavoid.safety.approach import NOBODY, PeopleNear, allowed_factor, outline_m
from densecavoid.safety.config import SafetyConfig, ZoneConfig
from densecavoid.safety.freeze import FreezeGuard
from densecavoid.safety.shapes import count_inside


@dataclass(frozen=True)
class SafeCommand:
    """What may go to the wheels."""

    linear_velocity: float
    angular_velocity: float
    action: str
    """pass, limit, slow-down, approach, escape or stop."""
    reason: str
    """Why, in words; empty for `pass`."""
    publish: bool = True
    """False: send nothing (inactive, or standing for so long that others may drive)."""


@dataclass(frozen=True)
class _Reduced:
    linear: float
    angular: float
    action: str
    reason: str

    def stricter(self, other: _Reduced) -> _Reduced:
        """Whichever is slower: by the linear velocity, then by the angular one."""
        mine, its = (abs(self.linear), abs(self.angular)), (abs(other.linear), abs(other.angular))
        return other if its < mine else self


class SafetyFilter:
    """Owns the age of commands and scans, the last output, and the memory of freezing. One robot.

    Call `command` when somebody wants to drive, `scan` and `people` when they are sensed, `update` at the control rate.
    """

    def __init__(self, config: SafetyConfig | None = None, *, active: bool = True) -> None:
        self.config = config or SafetyConfig()
        self.active = active
        """An inactive filter (a lifecycle node before activation) sends nothing at all."""
        self.enabled = True
        """Switched off, zones and approach do nothing; limits, finite numbers and dead controllers still count."""
        self._zones_on = {zone.name: zone.enabled for zone in self.config.zones}
        self._sources_on = dict.fromkeys(self.config.sources, True)
        self._scans: dict[str, tuple[float, Float[np.ndarray, "n 2"]]] = {}
        self._people: PeopleNear = NOBODY
        self._command: tuple[float, float, float] | None = None
        self._last = (0.0, 0.0)
        self._last_update_s: float | None = None
        self._standing_since: float | None = None
        self._freeze = FreezeGuard(self.config.freeze)

    # -- what it is told -----------------------------------------------------------------------------------------------

    def command(self, now_s: float, linear: float, angular: float) -> None:
        """Somebody wants to drive."""
        self._command = (now_s, float(linear), float(angular))

    def scan(self, now_s: float, source: str, points: Float[np.ndarray, "n 2"]) -> None:
        """Returns of a scan, in the robot's frame.

        Raises:
            ValueError: if the source is not configured, or a point is not finite.
        """
        choose("source", source, self.config.sources)
        require(np.isfinite(points).all(), f"points of {source!r}", "not finite", "finite (see shapes.scan_points)")
        self._scans[source] = (now_s, points)

    def people(self, people: PeopleNear) -> None:
        """Everybody who is tracked now; whoever is not finite is left out."""
        finite = np.isfinite(people.pos_r).all(1) & np.isfinite(people.vel_r).all(1) & np.isfinite(people.radius_m)
        self._people = PeopleNear(*(array[finite] for array in people))

    def enable_zone(self, name: str, on: bool) -> None:
        """Switches one zone; an unknown name raises ValueError."""
        self._zones_on[choose("zone", name, tuple(self._zones_on))] = on

    def enable_source(self, name: str, on: bool) -> None:
        """Switches one scan off (its points and its age count no more) or on."""
        self._sources_on[choose("source", name, self.config.sources)] = on

    def forget_freezing(self) -> None:
        """A new goal: what was before it does not count."""
        self._freeze.forget()

    # -- what it says --------------------------------------------------------------------------------------------------

    def update(
        self,
        now_s: float,
        pos_odom: tuple[float, float] | None = None,
        fault: str = "",
        wants_to_drive: bool | None = None,
    ) -> SafeCommand:
        """What may go to the wheels now.

        Args:
            now_s: a clock that never jumps.
            pos_odom: where odometry has the robot (m); without it nobody knows whether it is frozen.
            fault: a reason to stop that others found (the watchdog).
            wants_to_drive: whether there is a goal that is not reached; not known: whether the command is not zero.
        """
        dt = 0.0 if self._last_update_s is None else max(0.0, now_s - self._last_update_s)
        self._last_update_s = now_s
        if not self.active:
            self._last = (0.0, 0.0)
            return SafeCommand(0.0, 0.0, "stop", "not active", publish=False)
        reduced = self._decide(now_s, dt, pos_odom, fault, wants_to_drive)
        linear, angular = self._last = (reduced.linear, reduced.angular)
        standing = linear == 0.0 and angular == 0.0
        if not standing:
            self._standing_since = None
        elif self._standing_since is None:
            self._standing_since = now_s
        silent = (
            self.config.zero_for_s > 0
            and self._standing_since is not None
            and now_s - self._standing_since > self.config.zero_for_s
        )
        return SafeCommand(linear, angular, reduced.action, reduced.reason, publish=not silent)

    def _decide(
        self, now_s: float, dt: float, pos_odom: tuple[float, float] | None, fault: str, wants_to_drive: bool | None
    ) -> _Reduced:
        fault = fault or self._missing(now_s)
        if fault or self._command is None:
            self._freeze.forget()
            return _Reduced(0.0, 0.0, "stop", fault)
        _, linear, angular = self._command
        command = self._limited(linear, angular)
        if not self.enabled:
            return self._sped_up(command, dt)
        points = self._points(None)
        if pos_odom is not None and math.isfinite(pos_odom[0] + pos_odom[1]):
            drives = (linear, angular) != (0.0, 0.0) if wants_to_drive is None else wants_to_drive
            turn = self._freeze.update(
                now_s, pos_odom, drives, points, self._people, outline_m(self.config) + self.config.approach.margin_m
            )
            if turn is not None and not self.config.footprint:
                turn = min(max(turn, -self.config.max_angular_velocity), self.config.max_angular_velocity)
                return _Reduced(0.0, turn, "escape", "frozen: turning towards the freest direction")
        result = command
        for zone in self.config.zones:
            if self._zones_on[zone.name] and self._counts(zone, linear, angular):
                result = result.stricter(self._in_zone(zone, command))
        # Sped up first, judged then: the arc that is judged is the one that will be driven.
        result = self._sped_up(result, dt)
        if self.config.approach.enabled:
            factor, reason = allowed_factor(result.linear, result.angular, points, self._people, self.config)
            if factor < 1.0:
                return _Reduced(factor * result.linear, factor * result.angular, "approach", reason)
        return result

    def _missing(self, now_s: float) -> str:
        if self._command is None:
            return "no command yet"
        age = now_s - self._command[0]
        if not 0.0 <= age <= self.config.command_timeout_s:
            return f"no command for {age:.2f} s"
        if not all(map(math.isfinite, self._command[1:])):
            return f"command is not finite: {self._command[1:]}"
        if not self.enabled:
            return ""
        on = [source for source, is_on in self._sources_on.items() if is_on]
        if not on:
            return "no scan is switched on"
        for source in on:
            if source not in self._scans:
                return f"no {source!r} yet"
            age = now_s - self._scans[source][0]
            if not 0.0 <= age <= self.config.timeout_of(source):
                return f"{source!r} is {age:.2f} s old"
        return ""

    def _limited(self, linear: float, angular: float) -> _Reduced:
        config = self.config
        low, high = -config.max_reverse_velocity, config.max_linear_velocity
        inside = min(max(linear, low), high)
        turn = min(max(angular, -config.max_angular_velocity), config.max_angular_velocity)
        same = inside == linear and turn == angular
        return _Reduced(inside, turn, "pass" if same else "limit", "" if same else "limits of the robot")

    def _sped_up(self, wanted: _Reduced, dt: float) -> _Reduced:
        """The wanted velocity, reached within the limits of acceleration. Slowing down is never delayed."""
        linear = _sped_up(self._last[0], wanted.linear, self.config.max_linear_acceleration * dt)
        angular = _sped_up(self._last[1], wanted.angular, self.config.max_angular_acceleration * dt)
        return _Reduced(linear, angular, wanted.action, wanted.reason)

    def _points(self, sources: tuple[str, ...] | None) -> Float[np.ndarray, "n 2"]:
        parts = [
            points
            for source, (_, points) in self._scans.items()
            if self._sources_on[source] and (not sources or source in sources)
        ]
        return np.concatenate(parts) if parts else np.zeros((0, 2))

    @staticmethod
    def _counts(zone: ZoneConfig, linear: float, angular: float) -> bool:
        return zone.velocity is None or zone.velocity.contains(linear, angular)

    def _in_zone(self, zone: ZoneConfig, command: _Reduced) -> _Reduced:
        if count_inside(self._points(zone.sources), zone.polygon, zone.radius_m) < zone.min_points:
            return command
        reason = f"zone {zone.name!r}"
        if zone.action == "stop":
            return _Reduced(0.0, 0.0, "stop", reason)
        if zone.action == "slow-down":
            factor = zone.slow_down_ratio
        else:
            factor = min(
                1.0,
                zone.linear_limit / max(abs(command.linear), 1e-9),
                zone.angular_limit / max(abs(command.angular), 1e-9),
            )
            if factor == 1.0:
                return command
        return _Reduced(factor * command.linear, factor * command.angular, zone.action, reason)


def _sped_up(last: float, wanted: float, step: float) -> float:
    if last * wanted < 0.0:  # through zero first
        return 0.0
    return math.copysign(min(abs(wanted), abs(last) + step), wanted) if wanted else 0.0
