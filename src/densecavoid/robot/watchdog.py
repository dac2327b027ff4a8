"""Whether what the robot sees and is told may be acted upon, and if not, why. Knows no ROS and moves no wheels.

A message that is repeated, out of order, too old, from the future, of another frame or shape does not count: the
sensor then ages until it is stale. Ages are measured by a clock that never jumps; stamps, which may jump, by another.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from densecavoid.frames import choose, require


@dataclass(frozen=True)
class SensorLimits:
    """What is expected of one kind of message."""

    max_age_s: float = 0.3
    """From its stamp, and since the last good one: then it is stale."""
    frame: str = ""
    """Its frame; empty: the first one that comes is kept to."""
    required: bool = True
    """Whether the robot stands without it."""

    def __post_init__(self) -> None:
        require(0 < self.max_age_s < 60, "SensorLimits.max_age_s", self.max_age_s, "in (0, 60) s")


@dataclass(frozen=True)
class WatchdogConfig:
    """Limits of every input, and of the policy."""

    sensors: dict[str, SensorLimits] = field(
        default_factory=lambda: {name: SensorLimits() for name in ("scan", "depth", "odom")}
    )
    policy_timeout_s: float = 0.3
    """Without a new command of the policy for longer, it is late."""
    clock_jump_s: float = 0.5
    """A change of the stamps' clock against the steady one by more is a jump: everything must come afresh."""
    future_s: float = 0.1
    """Stamps farther ahead of the clock are refused."""

    def __post_init__(self) -> None:
        for name in ("policy_timeout_s", "clock_jump_s", "future_s"):
            value = getattr(self, name)
            require(0 < value < 60, f"WatchdogConfig.{name}", value, "in (0, 60) s")


@dataclass
class _Seen:
    good_at_s: float = -math.inf
    """By the steady clock."""
    stamp_s: float = -math.inf
    frame: str = ""
    shape: tuple[int, ...] = ()
    refused: int = 0
    accepted: int = 0
    reason: str = ""
    """Why the last message was refused; empty if it was not."""


class Watchdog:
    """Owns what was last seen of each sensor and of the policy.

    `now_s` is a steady clock everywhere, `ros_now_s` the clock that stamps are made with.
    """

    def __init__(self, config: WatchdogConfig | None = None) -> None:
        self.config = config or WatchdogConfig()
        self._seen = {name: _Seen() for name in self.config.sensors}
        self._policy_at_s = -math.inf
        self._policy_fault = ""
        self._clock_offset_s: float | None = None
        self._jump = ""
        self._goal_fault = "no goal yet"

    def tick(self, now_s: float, ros_now_s: float) -> bool:
        """Compares the clocks; to be called at the control rate.

        Returns:
            Whether the stamps' clock has jumped: whatever was kept with its stamps must be forgotten.
        """
        offset = ros_now_s - now_s
        known, self._clock_offset_s = self._clock_offset_s, offset
        if known is None or abs(offset - known) <= self.config.clock_jump_s:
            return False
        for seen in self._seen.values():
            seen.good_at_s = seen.stamp_s = -math.inf
        self._jump = f"clock jumped by {offset - known:+.2f} s"
        return True

    def check(
        self,
        sensor: str,
        now_s: float,
        ros_now_s: float,
        stamp_s: float,
        frame: str,
        shape: tuple[int, ...] = (),
        fault: str = "",
    ) -> str:
        """Judges one message.

        Args:
            sensor: one of the configuration's.
            stamp_s, frame, shape: the message's; another shape than the first good one's is wrong.
            fault: what its reader found wrong with it.

        Returns:
            Why it must not be used; empty: it may, and counts.
        """
        seen = self._seen[choose("sensor", sensor, tuple(self._seen))]
        seen.reason = fault or self._refusal(sensor, seen, ros_now_s, stamp_s, frame, shape)
        if seen.reason:
            seen.refused += 1
            return seen.reason
        seen.accepted += 1
        seen.good_at_s, seen.stamp_s, seen.frame, seen.shape = now_s, stamp_s, frame, shape
        return ""

    def reason(self, sensor: str) -> str:
        """Why the last message of a sensor was refused; empty if it was not."""
        return self._seen[sensor].reason

    def malformed(self, sensor: str, fault: str) -> None:
        """A message that could not even be read."""
        self.check(sensor, 0.0, 0.0, 0.0, "", fault=fault)

    def policy_acted(self, now_s: float) -> None:
        """The policy has given a command."""
        self._policy_at_s, self._policy_fault = now_s, ""

    def policy_failed(self, fault: str) -> None:
        """The policy has raised an exception."""
        self._policy_fault = f"policy failed: {fault}"

    def goal(self, fault: str) -> None:
        """Whether there is a goal that can be driven to: empty, or why not."""
        self._goal_fault = fault

    @property
    def goal_fault(self) -> str:
        """Why there is no goal that can be driven to; empty if there is one."""
        return self._goal_fault

    def sensors_fault(self, now_s: float) -> str:
        """Why nothing may be decided now; empty if all sensors are fresh."""
        for name, limits in self.config.sensors.items():
            if not limits.required:
                continue
            seen = self._seen[name]
            age = now_s - seen.good_at_s
            if age > limits.max_age_s:
                why = f" ({seen.reason})" if seen.reason else f" ({self._jump})" if self._jump else ""
                return f"no {name} yet{why}" if math.isinf(age) else f"{name} is {age:.2f} s old{why}"
        self._jump = ""
        return ""

    def fault(self, now_s: float) -> str:
        """Why the robot must stand now; empty if it may drive."""
        fault = self.sensors_fault(now_s) or self._goal_fault or self._policy_fault
        if fault:
            return fault
        late = now_s - self._policy_at_s
        if late > self.config.policy_timeout_s:
            return "no command of the policy yet" if math.isinf(late) else f"policy is {late:.2f} s late"
        return ""

    def report(self, now_s: float) -> dict[str, str]:
        """A line for each sensor: age, frame, how many were accepted and refused, and the last refusal."""
        return {
            name: (
                f"{now_s - seen.good_at_s:.2f} s old, {seen.accepted} accepted, {seen.refused} refused"
                + (f", last: {seen.reason}" if seen.reason else "")
            )
            for name, seen in self._seen.items()
        }

    def _refusal(
        self, sensor: str, seen: _Seen, ros_now_s: float, stamp_s: float, frame: str, shape: tuple[int, ...]
    ) -> str:
        limits = self.config.sensors[sensor]
        expected = limits.frame or seen.frame
        if expected and frame.lstrip("/") != expected.lstrip("/"):
            return f"frame {frame!r}, expected {expected!r}"
        if seen.shape and shape != seen.shape:
            return f"shape {shape}, expected {seen.shape}"
        if not math.isfinite(stamp_s):
            return f"stamp {stamp_s}"
        if stamp_s == seen.stamp_s:
            return "repeated"
        if stamp_s < seen.stamp_s:
            return f"out of order by {seen.stamp_s - stamp_s:.2f} s"
        age = ros_now_s - stamp_s
        if age > limits.max_age_s:
            return f"came {age:.2f} s late"
        if age < -self.config.future_s:
            return f"stamp is {-age:.2f} s in the future"
        return ""
