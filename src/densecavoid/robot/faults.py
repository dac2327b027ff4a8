"""The fault campaign: thousands of faults, drawn by seed, put between a driving robot's sensors and its runtime, and
what came of each. `densecavoid robot faults` prints it as a table.

A fault lasts a while; a fault that makes some input unusable for longer than its limit must stop the robot within
`STOP_S` of its beginning, and the robot must drive again within `RESUME_S` of its end, by itself. Shorter and milder
ones need not stop it. Whatever happens, no command may be over the limits or not finite.
"""

from __future__ import annotations

import copy
import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from densecavoid.frames import CameraConfig, LidarConfig, SensorFrame, require
from densecavoid.robot.config import RobotSettings
from densecavoid.robot.fault_world import FaultWorld
from densecavoid.robot.messages import Mount
from densecavoid.robot.runtime import RobotRuntime
from densecavoid.safety import NOBODY, FreezeConfig, PeopleNear, SafetyConfig

STOP_S = 0.6
RESUME_S = 2.0
"""From the end of the fault until it drives again: sensors, policy and acceleration together."""
DT = 0.05
_LAST_SAFE = 0.01


class ScriptedPilot:
    """Drives ahead at a steady speed; fails and dawdles when told to. Stands in for a policy."""

    name = "scripted"
    lidar = LidarConfig(num_rays=128)
    camera = CameraConfig(width=20, height=15)

    def __init__(self) -> None:
        self.mood = ""
        """Empty, `crash`, `nan` or `over`: asks for more than the robot may do."""

    def reset(self) -> None:
        """Nothing to forget."""

    def act(self, frame: SensorFrame) -> tuple[float, float]:
        """Ahead, and back to the middle of the corridor."""
        if self.mood == "crash":
            raise RuntimeError("told to")
        if self.mood == "nan":
            return math.nan, 0.0
        scale = 50.0 if self.mood == "over" else 1.0
        x_y_yaw = frame.odom_pose[0]
        return scale * 0.5, scale * float(-0.5 * x_y_yaw[1] - 1.0 * x_y_yaw[2])

    def people(self, pose: tuple[float, float, float]) -> PeopleNear:
        """It sees nobody."""
        return NOBODY

    def prediction(self) -> np.ndarray | None:
        """It predicts nothing."""
        return None


class Line:
    """The way of one kind of message from the sensor to the runtime, where faults happen."""

    def __init__(self, send: Callable[[Any], object]) -> None:
        self._send = send
        self._held: deque[tuple[float, Any]] = deque()
        self._last: Any = None
        self.fault = ""
        self.amount = 0.0

    def put(self, message: Any, now_s: float, rng: np.random.Generator) -> None:
        """A message leaves the sensor."""
        fault, last, self._last = self.fault, self._last, message
        if fault == "drop":
            return
        if fault == "delay":
            self._held.append((now_s + self.amount, message))
        elif fault == "repeat":
            self._send(last if last is not None else message)
            self._last = last if last is not None else message
        elif fault == "reorder":
            self._send(message)
            if last is not None:
                self._send(last)
        elif fault in _CORRUPTIONS:
            self._send(_CORRUPTIONS[fault](copy.deepcopy(message), rng))
        else:
            self._send(message)

    def deliver(self, now_s: float) -> None:
        """Messages that were held back arrive."""
        while self._held and self._held[0][0] <= now_s:
            self._send(self._held.popleft()[1])


def _corrupt(message: Any, rng: np.random.Generator) -> Any:
    """One field becomes something it must not be."""
    name = str(rng.choice([key for key in vars(message) if key != "child_frame_id"]))
    wrong: list[Any] = [None, -1, math.nan, math.inf, "x", 10**12, b"", []]
    setattr(message, name, wrong[int(rng.integers(len(wrong)))])
    return message


def _wrong_frame(message: Any, rng: np.random.Generator) -> Any:
    message.header.frame_id = str(rng.choice(["", "elsewhere", "map", "base_link"]))
    return message


def _truncate(message: Any, rng: np.random.Generator) -> Any:
    for name in ("ranges", "data"):
        if hasattr(message, name):
            part = getattr(message, name)
            setattr(message, name, part[: int(rng.integers(0, len(part)))])
    return message


def _noise(message: Any, rng: np.random.Generator) -> Any:
    message.ranges = message.ranges + 0.05 * rng.standard_normal(len(message.ranges)).astype(np.float32)
    return message


def _dead_sector(message: Any, rng: np.random.Generator) -> Any:
    message.ranges = message.ranges.copy()
    width = int(rng.integers(60, 120))
    start = int(rng.integers(60, len(message.ranges) - 60 - width))
    message.ranges[start : start + width] = rng.choice([np.nan, 0.0])
    return message


def _cover(message: Any, rng: np.random.Generator) -> Any:
    message.data = bytes(len(message.data))
    return message


def _nan_odometry(message: Any, rng: np.random.Generator) -> Any:
    message.pose.pose.position.x = float(rng.choice([np.nan, np.inf]))
    return message


_CORRUPTIONS: dict[str, Callable[[Any, np.random.Generator], Any]] = {
    "corrupt": _corrupt,
    "wrong-frame": _wrong_frame,
    "truncate": _truncate,
    "noise": _noise,
    "dead-sector": _dead_sector,
    "cover": _cover,
    "nan": _nan_odometry,
}


@dataclass(frozen=True)
class FaultKind:
    """One row of the table."""

    name: str
    target: str
    """scan, depth, odom, tf, clock, policy or process."""
    must_stop: bool
    """Whether it must stop the robot if it lasts."""


KINDS: tuple[FaultKind, ...] = (
    *(FaultKind("drop", target, True) for target in ("scan", "depth", "odom")),
    *(FaultKind("delay", target, True) for target in ("scan", "depth", "odom")),
    *(FaultKind("repeat", target, True) for target in ("scan", "depth", "odom")),
    *(FaultKind("reorder", target, False) for target in ("scan", "depth", "odom")),
    *(FaultKind("wrong-frame", target, True) for target in ("scan", "depth", "odom")),
    *(FaultKind("corrupt", target, False) for target in ("scan", "depth", "odom")),
    *(FaultKind("truncate", target, True) for target in ("scan", "depth")),
    FaultKind("nan", "odom", True),
    FaultKind("noise", "scan", False),
    FaultKind("dead-sector", "scan", True),
    FaultKind("cover", "depth", True),
    FaultKind("lost", "tf", True),
    FaultKind("jump", "clock", False),
    FaultKind("crash", "policy", True),
    FaultKind("nan", "policy", True),
    FaultKind("over", "policy", False),
    FaultKind("starved", "process", False),
    FaultKind("killed", "process", True),
)


@dataclass
class Row:
    """What came of all faults of one kind."""

    kind: FaultKind
    injected: int = 0
    lasting: int = 0
    """Those that had to stop the robot."""
    stopped: int = 0
    missed: int = 0
    hung: int = 0
    """It did not drive again by itself."""
    over_limit: int = 0
    unexplained: int = 0
    """Stops without a reason."""
    stop_s: list[float] = field(default_factory=list)
    resume_s: list[float] = field(default_factory=list)


def _settings() -> RobotSettings:
    # The corridor's end comes near now and then: the robot may wait there, but not turn round.
    safety = SafetyConfig(freeze=FreezeConfig(enabled=False))
    return RobotSettings(lidar_mount=Mount(), safety=safety)


class Campaign:
    """One robot that drives on and on while faults come and go."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.world = FaultWorld(self.rng)
        self.pilot = ScriptedPilot()
        self.rows = {(kind.name, kind.target): Row(kind) for kind in KINDS}
        self._tf_lost = False
        self._step = 0
        self._killed = False
        self._start_runtime()

    def _start_runtime(self) -> None:
        world = self.world
        self.runtime = runtime = RobotRuntime(self.pilot, _settings(), threaded=False)
        self.lines = {
            "scan": Line(lambda message: runtime.on_scan(message, world.now_s, world.ros_now_s)),
            "depth": Line(lambda message: runtime.on_depth(message, world.now_s, world.ros_now_s)),
            "odom": Line(lambda message: runtime.on_odom(message, world.now_s, world.ros_now_s)),
        }
        runtime.on_goal(world.goal(), world.now_s)

    def step(self, row: Row | None = None, starved: bool = False) -> tuple[float, str]:
        """One control step.

        Returns:
            The commanded speed (|v| + |w|), and what the runtime says about it.
        """
        world, runtime = self.world, self.runtime
        self._step += 1
        if self._killed or starved:
            world.drive(None, DT)
            return abs(world.velocity[0]) + abs(world.velocity[1]), "process gone"
        if self._step % 2 == 0:
            self.lines["scan"].put(world.scan(), world.now_s, self.rng)
            self.lines["depth"].put(world.depth(), world.now_s, self.rng)
        self.lines["odom"].put(world.odom(), world.now_s, self.rng)
        for line in self.lines.values():
            line.deliver(world.now_s)
        if not self._tf_lost:
            runtime.on_transforms(world.transforms("map", "odom"), world.now_s, static=False)
        result = runtime.step(world.now_s, world.ros_now_s)
        command = result.command
        limits = runtime.settings.safety
        values = (command.linear_velocity, command.angular_velocity)
        fine = all(map(math.isfinite, values))
        fine = fine and 0.0 <= values[0] <= limits.max_linear_velocity + 1e-9
        fine = fine and abs(values[1]) <= limits.max_angular_velocity + 1e-9
        if row is not None and not fine:
            row.over_limit += 1
        world.drive(values if command.publish and fine else None, DT)
        return abs(values[0]) + abs(values[1]), result.message

    def drive(self, seconds: float, row: Row | None = None) -> bool:
        """Without faults, until the robot drives.

        Returns:
            Whether it does, within that time.
        """
        return any(self.step(row)[0] > _LAST_SAFE for _ in range(round(seconds / DT)))

    def inject(self, kind: FaultKind) -> None:
        """One fault, from driving to driving again."""
        row, rng = self.rows[kind.name, kind.target], self.rng
        for _ in range(4):
            self.step(row)
        row.injected += 1
        duration = float(rng.choice([rng.uniform(0.05, 0.3), rng.uniform(0.8, 1.6)], p=[0.3, 0.7]))
        lasting = kind.must_stop and duration >= 0.8
        # Nobody but the base notices a killed process: after .6 s it brakes, for up to .55 s.
        allowed = STOP_S
        if kind.target == "tf":
            duration, lasting = float(rng.uniform(1.0, 2.0)), True
        if kind.name == "killed":
            duration, lasting, allowed = 2.0, True, STOP_S + 0.55
        self._begin(kind)
        stopped_after = math.inf
        for step in range(round(duration / DT)):
            speed, reason = self.step(row, starved=kind.name == "starved")
            if speed <= _LAST_SAFE and math.isinf(stopped_after):
                stopped_after = (step + 1) * DT
                row.unexplained += reason in ("", "driving")
            if stopped_after < math.inf and lasting and speed > _LAST_SAFE:
                row.missed += 1  # drove on although it lasts
                break
        self._end(kind)
        row.lasting += lasting
        if stopped_after < math.inf:
            row.stopped += 1
            row.stop_s.append(stopped_after)
        if lasting and stopped_after > allowed:
            row.missed += 1
        for step in range(round(4 * RESUME_S / DT)):
            if self.step(row)[0] > _LAST_SAFE:
                row.resume_s.append((step + 1) * DT)
                break
        else:
            row.hung += 1
        if row.resume_s and row.resume_s[-1] > RESUME_S:
            row.hung += 1

    def _begin(self, kind: FaultKind) -> None:
        if kind.target in self.lines:
            line = self.lines[kind.target]
            line.fault, line.amount = kind.name, float(self.rng.uniform(0.45, 0.7))
        elif kind.target == "tf":
            self._tf_lost = True
        elif kind.target == "policy":
            self.pilot.mood = kind.name
        elif kind.target == "clock":
            self.world.clock_offset_s += float(self.rng.choice([-1, 1]) * self.rng.uniform(1.0, 1000.0))
        elif kind.name == "killed":
            self._killed = True

    def _end(self, kind: FaultKind) -> None:
        for line in self.lines.values():
            line.fault = ""
        self._tf_lost, self.pilot.mood = False, ""
        if self._killed:
            self._killed = False
            self._start_runtime()


@dataclass(frozen=True)
class FaultsConfig:
    """A fault campaign."""

    number: int = 10_000
    """Faults to inject, of all kinds in turn."""
    seed: int = 0

    def __post_init__(self) -> None:
        require(self.number >= 1, "number", self.number, "at least 1")


def run_faults(config: FaultsConfig) -> list[Row]:
    """The whole campaign."""
    campaign = Campaign(config.seed)
    require(campaign.drive(5.0), "the robot without faults", "standing", "driving")
    for index in range(config.number):
        campaign.inject(KINDS[index % len(KINDS)])
    return list(campaign.rows.values())


def table(rows: list[Row]) -> str:
    """Rows as text, with a line of sums."""
    lines = [
        f"{'fault':12} {'of':8} {'injected':>8} {'lasting':>7} {'stopped':>7} {'missed':>6} {'hung':>4} "
        f"{'over limit':>10} {'unexplained':>11} {'stop s p50 max':>15} {'resume s p50 max':>17}"
    ]

    def times(values: list[float]) -> str:
        return f"{np.median(values):.2f} {max(values):.2f}" if values else "-"

    for row in rows:
        lines.append(
            f"{row.kind.name:12} {row.kind.target:8} {row.injected:8} {row.lasting:7} {row.stopped:7} {row.missed:6} "
            f"{row.hung:4} {row.over_limit:10} {row.unexplained:11} {times(row.stop_s):>15} {times(row.resume_s):>17}"
        )
    sums = [sum(getattr(row, name) for row in rows) for name in ("injected", "lasting", "stopped", "missed", "hung")]
    lines.append(
        f"{'all':12} {'':8} {sums[0]:8} {sums[1]:7} {sums[2]:7} {sums[3]:6} {sums[4]:4} "
        f"{sum(row.over_limit for row in rows):10} {sum(row.unexplained for row in rows):11}"
    )
    return "\n".join(lines)
