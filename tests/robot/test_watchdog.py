"""Whatever is stale, repeated, out of order, of another frame or shape does not count, and the reason says so."""

from __future__ import annotations

import math

import pytest

from densecavoid.robot.watchdog import Watchdog

OFFSET = 1000.0


class Bench:
    """A watchdog with good messages of all sensors every .1 s, but for what a test does instead."""

    def __init__(self) -> None:
        self.watchdog, self.now, self.offset = Watchdog(), 5.0, OFFSET
        self.watchdog.goal("")
        self.run(0.5)

    def send(self, sensor: str, stamp: float | None = None, frame: str = "f", shape: tuple[int, ...] = (3,)) -> str:
        ros_now = self.now + self.offset
        return self.watchdog.check(sensor, self.now, ros_now, ros_now if stamp is None else stamp, frame, shape)

    def run(self, seconds: float, without: str = "") -> list[str]:
        faults = []
        for _ in range(round(seconds / 0.1)):
            self.now += 0.1
            self.watchdog.tick(self.now, self.now + self.offset)
            for sensor in ("scan", "depth", "odom"):
                if sensor != without:
                    self.send(sensor)
            if not self.watchdog.sensors_fault(self.now):
                self.watchdog.policy_acted(self.now)
            faults.append(self.watchdog.fault(self.now))
        return faults


def test_good_messages_let_it_drive() -> None:
    assert Bench().run(1.0) == [""] * 10


@pytest.mark.parametrize("sensor", ["scan", "depth", "odom"])
def test_a_silent_sensor_stops_it_after_its_limit_and_good_data_let_it_go_on(sensor: str) -> None:
    bench = Bench()
    faults = bench.run(1.0, without=sensor)
    assert faults[:3] == ["", "", ""] or faults[:2] == ["", ""]
    assert faults[3].startswith(f"{sensor} is 0.4") and all(faults[3:])
    assert bench.run(0.2)[-1] == ""


def test_messages_that_do_not_count_are_named() -> None:
    bench = Bench()
    last = bench.now + OFFSET
    bench.now += 0.05
    assert bench.send("scan", last) == "repeated"
    assert bench.send("scan", last - 0.2) == "out of order by 0.20 s"
    assert bench.send("scan", bench.now + OFFSET - 0.0, frame="elsewhere") == "frame 'elsewhere', expected 'f'"
    assert bench.send("scan", shape=(4,)) == "shape (4,), expected (3,)"
    assert bench.send("scan", math.nan) == "stamp nan"
    assert bench.send("scan", bench.now + OFFSET + 0.5).endswith("in the future")
    bench.now += 0.6
    assert bench.send("scan", bench.now + OFFSET - 0.5) == "came 0.50 s late"
    assert "came 0.50 s late" in bench.watchdog.fault(bench.now)
    assert bench.send("scan") == ""


@pytest.mark.parametrize("jump", [-500.0, 500.0])
def test_after_a_jump_of_the_clock_everything_must_come_afresh(jump: float) -> None:
    bench = Bench()
    bench.offset += jump
    bench.now += 0.05
    assert bench.watchdog.tick(bench.now, bench.now + bench.offset)
    assert "clock jumped" in bench.watchdog.fault(bench.now)
    assert bench.run(0.2)[-1] == ""


def test_policy_late_crashed_and_goal_lost() -> None:
    bench = Bench()
    bench.watchdog.policy_failed("ValueError: x")
    assert bench.watchdog.fault(bench.now) == "policy failed: ValueError: x"
    bench.watchdog.policy_acted(bench.now)
    assert bench.watchdog.fault(bench.now) == ""
    for _ in range(5):
        bench.now += 0.1
        for sensor in ("scan", "depth", "odom"):
            bench.send(sensor)
    assert bench.watchdog.fault(bench.now) == "policy is 0.50 s late"
    bench.watchdog.goal("goal lost: no transform")
    assert bench.watchdog.fault(bench.now) == "goal lost: no transform"
