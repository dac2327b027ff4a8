"""What the safety filter is told: the robot's limits, zones, the approach, freezing. Plain numbers, as in a YAML file.

Shapes are polygons ((x, y), ...) or a radius about the robot's centre, in its frame (m; x ahead, y left).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from densecavoid.frames import choose, require

Point = tuple[float, float]


@dataclass(frozen=True)
class VelocityRange:
    """Velocities at which a zone counts: it may be longer at speed than at a crawl."""

    linear: tuple[float, float] = (-math.inf, math.inf)
    angular: tuple[float, float] = (-math.inf, math.inf)

    def __post_init__(self) -> None:
        for name, (low, high) in (("linear", self.linear), ("angular", self.angular)):
            require(low <= high, f"VelocityRange.{name}", (low, high), "low <= high")

    def contains(self, linear: float, angular: float) -> bool:
        """Whether the velocity lies inside, ends included."""
        return self.linear[0] <= linear <= self.linear[1] and self.angular[0] <= angular <= self.angular[1]


@dataclass(frozen=True)
class ZoneConfig:
    """One area around the robot, and what happens while something is in it."""

    name: str
    action: Literal["stop", "slow-down", "limit"]
    polygon: tuple[Point, ...] = ()
    radius_m: float = 0.0
    """A circle instead of a polygon."""
    min_points: int = 3
    """Fewer returns inside are taken for noise."""
    slow_down_ratio: float = 0.5
    """Factor on the command, for `slow-down`."""
    linear_limit: float = 0.3
    """m/s, for `limit`."""
    angular_limit: float = 0.4
    """rad/s, for `limit`."""
    sources: tuple[str, ...] = ()
    """Scans that count; none named: all."""
    velocity: VelocityRange | None = None
    """Commands for which the zone counts; without it, all."""
    enabled: bool = True

    def __post_init__(self) -> None:
        name = f"zone {self.name!r}"
        require(bool(self.name), "ZoneConfig.name", self.name, "not empty")
        choose(f"action of {name}", self.action, ("stop", "slow-down", "limit"))
        has_polygon, has_radius = len(self.polygon) > 0, self.radius_m != 0
        require(has_polygon != has_radius, f"{name}: shape", (self.polygon, self.radius_m), "a polygon or a radius_m")
        require(
            not has_polygon or 3 <= len(self.polygon) <= 64, f"{name}: polygon", len(self.polygon), "3 to 64 corners"
        )
        require(
            all(math.isfinite(value) for corner in self.polygon for value in corner),
            f"{name}: polygon",
            self.polygon,
            "finite",
        )
        require(0 <= self.radius_m < 100, f"{name}: radius_m", self.radius_m, "in [0, 100)")
        require(self.min_points >= 1, f"{name}: min_points", self.min_points, "at least 1")
        require(0 <= self.slow_down_ratio <= 1, f"{name}: slow_down_ratio", self.slow_down_ratio, "in [0, 1]")
        require(self.linear_limit >= 0, f"{name}: linear_limit", self.linear_limit, "0 or more")
        require(self.angular_limit >= 0, f"{name}: angular_limit", self.angular_limit, "0 or more")


@dataclass(frozen=True)
class ApproachConfig:
    """No nearer than the robot can still brake for: see `safety.approach`."""

    enabled: bool = True
    margin_m: float = 0.08
    """Kept between the robot's outline and whatever is met."""
    time_before_collision_s: float = 1.0
    """Commands that lead to contact sooner are slowed down in proportion."""
    reaction_s: float = 0.2
    """From what is sensed to brakes that grip: age of the scan, one control step, the base's own delay."""
    person_margin_m: float = 0.10
    """Kept from people's bodies on top: they swing and sway."""
    person_speed_error: float = 0.2
    """m/s by which people's predicted places become uncertain."""
    max_person_speed: float = 2.2
    """m/s; faster tracks are taken for faulty and cut to it (top of people's free speeds)."""
    min_points: int = 2
    """Fewer returns in the way are taken for noise."""

    def __post_init__(self) -> None:
        for name in (
            "margin_m",
            "time_before_collision_s",
            "reaction_s",
            "person_margin_m",
            "person_speed_error",
            "max_person_speed",
        ):
            value = getattr(self, name)
            require(0 <= value <= 10, f"ApproachConfig.{name}", value, "in [0, 10]")
        require(self.min_points >= 1, "ApproachConfig.min_points", self.min_points, "at least 1")


@dataclass(frozen=True)
class FreezeConfig:
    """When the robot counts as frozen, and how it turns out of it: see `safety.freeze`."""

    enabled: bool = True
    window_s: float = 6.0
    """A net displacement under `distance_m` in this time, while it wants to drive, is freezing."""
    distance_m: float = 0.3
    turn_rate: float = 0.4
    """rad/s of the escape."""
    aligned_rad: float = 0.15
    """The escape is over when the freest direction is this near to straight ahead."""
    max_turn_s: float = 9.0
    """And after this time at the latest (more than a whole turn at .8 rad/s)."""
    reach_m: float = 3.0
    """Free space beyond this makes no direction better."""

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            if name != "enabled":
                value = getattr(self, name)
                require(0 < value < 1000, f"FreezeConfig.{name}", value, "positive")


def _default_zones() -> tuple[ZoneConfig, ...]:
    return (
        ZoneConfig("bumper", "stop", polygon=((0.30, 0.16), (0.30, -0.16), (0.0, -0.20), (0.0, 0.20))),
        ZoneConfig("ahead", "slow-down", polygon=((0.70, 0.25), (0.70, -0.25), (0.0, -0.25), (0.0, 0.25))),
    )


@dataclass(frozen=True)
class SafetyConfig:
    """The whole filter. The default is a Turtlebot 2 as in `frames.RobotConfig`."""

    radius_m: float = 0.18
    footprint: tuple[Point, ...] = ()
    """Corners of a robot that is no disc; `radius_m` is then not used."""
    max_linear_velocity: float = 1.0
    max_reverse_velocity: float = 0.0
    max_angular_velocity: float = 0.4
    max_linear_acceleration: float = 1.0
    max_angular_acceleration: float = 3.5
    braking: float = 1.0
    """m/s2 with which the base stops, at the least."""
    zones: tuple[ZoneConfig, ...] = _default_zones()
    approach: ApproachConfig = ApproachConfig()
    freeze: FreezeConfig = FreezeConfig()
    sources: tuple[str, ...] = ("scan",)
    """Scans that must be there."""
    source_timeout_s: float = 0.3
    source_timeouts: tuple[tuple[str, float], ...] = ()
    """For single sources; 0: never stale."""
    command_timeout_s: float = 0.3
    """Without a command for longer, the robot stops: its controller is dead."""
    zero_for_s: float = 1.0
    """After so long a standstill nothing is sent, so that others may drive; 0: always send."""

    def __post_init__(self) -> None:
        for name in (
            "max_linear_velocity",
            "max_angular_velocity",
            "max_linear_acceleration",
            "max_angular_acceleration",
            "braking",
            "radius_m",
            "command_timeout_s",
        ):
            value = getattr(self, name)
            require(0 < value < 100, f"SafetyConfig.{name}", value, "positive")
        require(0 <= self.max_reverse_velocity < 100, "max_reverse_velocity", self.max_reverse_velocity, "0 or more")
        require(0 < self.source_timeout_s < 100, "source_timeout_s", self.source_timeout_s, "positive")
        require(0 <= self.zero_for_s < 1e6, "zero_for_s", self.zero_for_s, "0 or more")
        require(len(self.footprint) in (0, *range(3, 65)), "SafetyConfig.footprint", self.footprint, "3 to 64 corners")
        require(len(self.sources) > 0, "SafetyConfig.sources", self.sources, "at least one: nothing is safe unseen")
        require(len(set(self.sources)) == len(self.sources), "SafetyConfig.sources", self.sources, "different names")
        names = [zone.name for zone in self.zones]
        require(len(set(names)) == len(names), "SafetyConfig.zones", names, "different names")
        for zone in self.zones:
            for source in zone.sources:
                choose(f"source of zone {zone.name!r}", source, self.sources)
        for source, timeout in self.source_timeouts:
            choose("source in source_timeouts", source, self.sources)
            require(0 <= timeout < 100, f"timeout of source {source!r}", timeout, "in [0, 100) s")

    def timeout_of(self, source: str) -> float:
        """Seconds after which a source is stale; infinite if never."""
        return dict(self.source_timeouts).get(source, self.source_timeout_s) or math.inf
