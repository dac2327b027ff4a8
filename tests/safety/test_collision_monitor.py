"""The behaviours that the tests of Nav2's collision monitor name, one test each, and its acceptance figures."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from kobuki import wall

from densecavoid.safety import (
    ApproachConfig,
    FreezeConfig,
    SafeCommand,
    SafetyConfig,
    SafetyFilter,
    VelocityRange,
    ZoneConfig,
)

DT = 0.05
NOTHING = np.zeros((0, 2))
NO_APPROACH = ApproachConfig(enabled=False)
STOP = ZoneConfig("stop", "stop", radius_m=0.4)
SLOW = ZoneConfig("slow", "slow-down", radius_m=0.8, slow_down_ratio=0.3)
LIMIT = ZoneConfig("limit", "limit", radius_m=1.2, linear_limit=0.4, angular_limit=0.2)
ZONES = SafetyConfig(zones=(STOP, SLOW, LIMIT), approach=NO_APPROACH)
APPROACH = SafetyConfig(zones=())


class Clock:
    """Drives one filter with one command and one scan for as long as asked."""

    def __init__(self, config: SafetyConfig, command: tuple[float, float] = (0.6, 0.0)) -> None:
        self.filter, self.command, self.now_s = SafetyFilter(config), command, 100.0

    def run(
        self, points: np.ndarray | None, seconds: float = 1.5, *, commands: bool = True, source: str = "scan"
    ) -> list[SafeCommand]:
        outputs = []
        for _ in range(round(seconds / DT)):
            self.now_s += DT
            if commands:
                self.filter.command(self.now_s, *self.command)
            if points is not None:
                self.filter.scan(self.now_s, source, points)
            outputs.append(self.filter.update(self.now_s))
        return outputs

    def last(self, points: np.ndarray | None, seconds: float = 1.5, *, source: str = "scan") -> SafeCommand:
        return self.run(points, seconds, source=source)[-1]


def test_process_stop_slowdown_limit() -> None:
    clock = Clock(ZONES)
    assert clock.last(wall(3.0)).action == "pass"
    limited = clock.last(wall(1.0, 0.2))
    assert (limited.action, limited.reason) == ("limit", "zone 'limit'")
    assert limited.linear_velocity == pytest.approx(0.4)
    slowed = clock.last(wall(0.6, 0.2))
    assert (slowed.action, slowed.reason) == ("slow-down", "zone 'slow'")
    assert slowed.linear_velocity == pytest.approx(0.3 * 0.6)
    stopped = clock.last(wall(0.35, 0.2), DT)
    assert (stopped.linear_velocity, stopped.action, stopped.reason) == (0.0, "stop", "zone 'stop'")
    assert clock.last(wall(3.0)).linear_velocity == pytest.approx(0.6)


def test_process_approach() -> None:
    """Braking from v must fit into the way left: v .2 + v2 / 2 = way, and contact must be 1 s away."""
    clock = Clock(APPROACH)
    assert clock.last(wall(3.0)).linear_velocity == pytest.approx(0.6)
    for distance in (0.9, 0.7, 0.5, 0.4):
        speed = clock.last(wall(distance)).linear_velocity
        way = distance - 0.18 - 0.08
        assert 0.2 * speed + speed**2 / 2 <= way + 1e-6
        assert speed > 0.5 * min(0.6, -0.2 + math.sqrt(0.04 + 2 * way), way)
    assert clock.last(wall(0.26)).linear_velocity == pytest.approx(0.0, abs=1e-6)


def test_process_approach_rotation() -> None:
    """A long robot that turns in place must not hit what its corner sweeps; a disc may turn."""
    long = SafetyConfig(footprint=((0.5, 0.1), (0.5, -0.1), (-0.5, -0.1), (-0.5, 0.1)), zones=())
    beside = wall(0.3, 0.04, 0.01) @ np.array([[0.0, 1.0], [1.0, 0.0]])  # a pole .3 m to the left
    turning = Clock(long, (0.0, 0.4))
    far = turning.last(beside)
    assert 0 < far.angular_velocity <= 0.4
    angle_left = math.atan2(0.3, 0.35) - 0.1
    pole = 0.35 * np.array([[math.cos(a), math.sin(a)] for a in np.linspace(angle_left, angle_left + 0.05, 5)])
    assert turning.last(pole).angular_velocity < 0.35
    touching = 0.45 * np.array([[math.cos(a), math.sin(a)] for a in np.linspace(0.33, 0.40, 5)])
    assert turning.last(touching).angular_velocity < 0.1
    assert Clock(APPROACH, (0.0, 0.4)).last(wall(0.22)).angular_velocity == pytest.approx(0.4)


def test_cross_over() -> None:
    """Slow-down zone and approach together: whichever is the stricter wins, as a thing comes nearer."""
    config = dataclasses.replace(APPROACH, zones=(ZoneConfig("slow", "slow-down", radius_m=1.5, slow_down_ratio=0.5),))
    clock = Clock(config)
    at_first = clock.last(wall(1.4))
    assert at_first.action == "slow-down" and at_first.linear_velocity == pytest.approx(0.3)
    nearer = clock.last(wall(0.4))
    assert nearer.action == "approach" and 0 < nearer.linear_velocity < 0.3
    assert clock.last(wall(3.0)).action == "pass"


def test_source_timeout() -> None:
    clock = Clock(ZONES)
    assert clock.last(NOTHING).linear_velocity > 0
    late = clock.run(None, 0.6)
    stopped = [i for i, output in enumerate(late) if output.action == "stop"]
    assert stopped[0] * DT <= 0.3 + DT and late[-1].linear_velocity == 0.0
    assert "'scan' is" in late[-1].reason and "old" in late[-1].reason


def test_source_timeout_override() -> None:
    """A timeout of 0 for one source: it may be as old as it likes, the other may not."""
    config = dataclasses.replace(ZONES, sources=("scan", "bumper"), source_timeouts=(("bumper", 0.0),))
    clock = Clock(config)
    clock.filter.scan(clock.now_s, "bumper", NOTHING)
    assert clock.last(NOTHING, 30.0).action == "pass"
    assert "'scan' is" in clock.last(None).reason


def test_cease_publish_zero_velocity() -> None:
    clock = Clock(ZONES)
    outputs = clock.run(wall(0.3, 0.2), 2.0)
    assert all(output.linear_velocity == 0 for output in outputs)
    assert all(output.publish for output in outputs[: round(0.9 / DT)])
    assert not any(output.publish for output in outputs[-round(0.8 / DT) :])
    assert clock.last(wall(3.0)).publish
    forever = Clock(dataclasses.replace(ZONES, zero_for_s=0.0))
    assert forever.last(wall(0.3, 0.2), 3.0).publish


def test_source_not_enabled() -> None:
    clock = Clock(dataclasses.replace(ZONES, sources=("scan", "rear")))
    clock.filter.scan(clock.now_s, "rear", wall(0.3, 0.2))
    clock.filter.enable_source("rear", False)
    assert clock.last(NOTHING).action == "pass"  # neither its points nor its age count
    clock.filter.enable_source("rear", True)
    assert clock.last(NOTHING).action == "stop"


def test_process_non_active() -> None:
    clock = Clock(ZONES)
    clock.filter.active = False
    assert not any(output.publish for output in clock.run(NOTHING))
    clock.filter.active = True
    assert clock.last(NOTHING).publish


def test_incorrect_source_type() -> None:
    clock = Clock(ZONES)
    with pytest.raises(ValueError, match="unknown source 'sonar', expected one of: scan"):
        clock.filter.scan(0.0, "sonar", NOTHING)
    with pytest.raises(ValueError, match="finite"):
        clock.filter.scan(0.0, "scan", np.array([[np.nan, 0.0]]))


def test_sources_not_set() -> None:
    with pytest.raises(ValueError, match="sources"):
        SafetyConfig(sources=())
    with pytest.raises(ValueError, match="unknown source of zone 'z' 'sonar'"):
        SafetyConfig(zones=(ZoneConfig("z", "stop", radius_m=1.0, sources=("sonar",)),))


def test_velocity_polygon_stop() -> None:
    """The stop zone is long when driving fast and short when turning slowly."""
    box = ((0.4, 0.3), (0.4, -0.3), (-0.3, -0.3), (-0.3, 0.3))
    long = tuple((2 * x, y) for x, y in box)
    zones = (
        ZoneConfig("fast", "stop", polygon=long, velocity=VelocityRange(linear=(0.3, 1.0))),
        ZoneConfig("slow", "stop", polygon=box, velocity=VelocityRange(linear=(-1.0, 0.3))),
    )
    config = SafetyConfig(zones=zones, approach=NO_APPROACH)
    assert Clock(config, (0.6, 0.0)).last(wall(0.6, 0.2)).reason == "zone 'fast'"
    assert Clock(config, (0.2, 0.0)).last(wall(0.6, 0.2)).action == "pass"
    assert Clock(config, (0.2, 0.0)).last(wall(0.3, 0.2)).reason == "zone 'slow'"


def test_toggle_service() -> None:
    clock = Clock(ZONES)
    assert clock.last(wall(0.3, 0.2)).action == "stop"
    clock.filter.enabled = False
    assert clock.last(wall(0.3, 0.2)).action == "pass"
    clock.filter.enabled = True
    clock.filter.enable_zone("stop", False)
    assert clock.last(wall(0.3, 0.2)).action == "slow-down"
    with pytest.raises(ValueError, match="unknown zone 'stopp'"):
        clock.filter.enable_zone("stopp", True)


def test_acceptance_figures(capsys: pytest.CaptureFixture[str]) -> None:
    """Time to stop and to resume at most .6 s, hold at least 90 %, false stops at most 5 %: scans at 10 Hz with noise
    of 2 cm, 2 % of the rays giving a return out of nothing, things that come and go 30 times."""
    rng = np.random.default_rng(7)
    filter_ = SafetyFilter(SafetyConfig(freeze=FreezeConfig(enabled=False)))
    now, time_to_stop, time_to_resume, held, free = 0.0, [], [], [], []

    def stand(seconds: float, x: float) -> list[bool]:
        nonlocal now
        moves = []
        for step in range(round(seconds / DT)):
            now += DT
            filter_.command(now, 0.3, 0.0)
            if step % 2 == 0:
                points = wall(x, 0.6)
                points = points + 0.02 * rng.standard_normal(points.shape)
                ghosts = rng.random(512) < 0.02
                angle, way = rng.uniform(-2.09, 2.09, ghosts.sum()), rng.uniform(0.3, 4.0, ghosts.sum())
                points = np.concatenate([points, np.stack([way * np.cos(angle), way * np.sin(angle)], axis=1)])
                filter_.scan(now, "scan", points)
            moves.append(filter_.update(now).linear_velocity > 0.01)
        return moves

    for _ in range(30):
        moves = stand(2.0, 3.0)
        time_to_resume.append(DT * (moves.index(True) + 1))
        free.extend(moves[round(0.6 / DT) :])
        moves = stand(2.0, 0.22)
        time_to_stop.append(DT * (moves.index(False) + 1))
        held.extend(not move for move in moves[round(0.6 / DT) :])
    hold, false_stops = np.mean(held), 1 - np.mean(free)
    with capsys.disabled():
        print(
            f"\ntime to stop {max(time_to_stop):.2f} s, hold {hold:.1%}, "
            f"time to resume {max(time_to_resume):.2f} s, false stops {false_stops:.2%}"
        )
    assert max(time_to_stop) <= 0.6 and hold >= 0.9
    assert max(time_to_resume) <= 0.6 and false_stops <= 0.05
