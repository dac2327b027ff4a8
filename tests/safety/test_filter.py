"""Promises of the filter beyond Nav2's: limits for any input, people met standing, dead controllers, freezing."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from kobuki import Kobuki, wall

from densecavoid.safety import NOBODY, FreezeConfig, SafetyConfig, SafetyFilter, scan_points
from densecavoid.safety.approach import allowed_factor
from densecavoid.safety.freeze import freest_direction
from densecavoid.safety.shapes import in_polygon

NOTHING = np.zeros((0, 2))
ANY = st.floats(allow_nan=True, allow_infinity=True, width=64)


@settings(max_examples=150, deadline=None)
@given(commands=st.lists(st.tuples(ANY, ANY), min_size=1, max_size=8), dt=st.floats(0.0, 0.3))
def test_whatever_is_asked_the_output_is_finite_and_within_limits(
    commands: list[tuple[float, float]], dt: float
) -> None:
    config = SafetyConfig()
    filter_, now, last = SafetyFilter(config), 0.0, 0.0
    for linear, angular in commands:
        now += dt
        filter_.command(now, linear, angular)
        filter_.scan(now, "scan", NOTHING)
        output = filter_.update(now)
        assert math.isfinite(output.linear_velocity) and math.isfinite(output.angular_velocity)
        assert 0.0 <= output.linear_velocity <= config.max_linear_velocity
        assert abs(output.angular_velocity) <= config.max_angular_velocity
        assert output.linear_velocity <= last + config.max_linear_acceleration * dt + 1e-9
        if not (math.isfinite(linear) and math.isfinite(angular)):
            assert output.linear_velocity == 0.0 and "not finite" in output.reason
        last = output.linear_velocity


def test_a_dead_controller_is_noticed_without_any_call_from_it() -> None:
    filter_ = SafetyFilter()
    for now in np.arange(0.0, 1.0, 0.05):
        filter_.scan(now, "scan", NOTHING)
        filter_.command(now, 0.5, 0.0)
        assert filter_.update(now).action == "pass"
    outputs = []
    for now in np.arange(1.0, 2.0, 0.05):
        filter_.scan(now, "scan", NOTHING)
        outputs.append(filter_.update(now))
    assert outputs[6].linear_velocity == 0.0 and outputs[-1].reason.startswith("no command for")


def meet(rng: np.random.Generator, seconds: float = 6.0, dt: float = 0.1) -> tuple[bool, float]:
    """One encounter: the robot wants to drive at full speed and turns a little, somebody walks straight at a free speed
    to where it may be.

    Returns:
        Whether the bodies met, and the robot's speed then.
    """
    robot, filter_ = Kobuki(), SafetyFilter(SafetyConfig(freeze=FreezeConfig(enabled=False)))
    bearing, distance = rng.uniform(-2.6, 2.6), rng.uniform(3.0, 6.0)
    pos = distance * np.array([[math.cos(bearing), math.sin(bearing)]])
    aim = np.array([rng.uniform(0.0, 3.0), rng.uniform(-0.5, 0.5)])
    speed = np.clip(rng.normal(1.34, 0.26), 0.5, 2.2)
    vel = speed * (aim - pos) / np.linalg.norm(aim - pos)
    turn = rng.uniform(-0.4, 0.4)
    now = 0.0
    for _ in range(round(seconds / dt)):
        now += dt
        filter_.command(now, 1.0, turn)
        filter_.scan(now, "scan", NOTHING)
        filter_.people(robot.people(pos, vel))
        output = filter_.update(now)
        robot.drive((output.linear_velocity, output.angular_velocity), dt)
        pos = pos + vel * dt
        if np.linalg.norm(pos[0] - robot.pose[:2]) < 0.18 + 0.25:
            return True, robot.velocity[0]
    return False, 0.0


def test_it_stands_before_anybody_at_a_free_speed_touches_it() -> None:
    """At fault is a robot faster than .1 m/s at the contact (BENCHMARK.md); it should stand altogether."""
    meetings = [meet(np.random.default_rng(seed)) for seed in range(60)]
    speeds = np.array([speed for met, speed in meetings if met])
    assert len(speeds) > 12  # somebody must have walked into it for the test to mean something
    assert speeds.max() <= 0.02


def test_without_the_approach_the_same_meetings_are_collisions() -> None:
    """The test above can fail: whoever drives on meets people at speed."""
    from densecavoid.safety import ApproachConfig

    config = SafetyConfig(approach=ApproachConfig(enabled=False), zones=())
    filter_, robot = SafetyFilter(config), Kobuki()
    pos, vel = np.array([[4.0, 0.0]]), np.array([[-1.34, 0.0]])
    for now in np.arange(0.05, 4.0, 0.05):
        filter_.command(now, 1.0, 0.0)
        filter_.scan(now, "scan", NOTHING)
        filter_.people(robot.people(pos, vel))
        output = filter_.update(now)
        robot.drive((output.linear_velocity, output.angular_velocity), 0.05)
        pos = pos + 0.05 * vel
        if np.linalg.norm(pos[0] - robot.pose[:2]) < 0.43:
            break
    assert robot.velocity[0] > 0.5


@pytest.mark.parametrize("speed", [0.3, 0.6, 1.0])
def test_it_stops_before_a_wall_with_the_bases_braking(speed: float) -> None:
    robot, filter_ = Kobuki(), SafetyFilter(SafetyConfig(zones=(), freeze=FreezeConfig(enabled=False)))
    for now in np.arange(0.05, 12.0, 0.05):
        filter_.command(now, speed, 0.0)
        filter_.scan(now, "scan", robot.to_robot(wall(3.0, 2.0)))
        output = filter_.update(now)
        robot.drive((output.linear_velocity, output.angular_velocity), 0.05)
        assert robot.pose[0] + 0.18 < 3.0
    assert robot.pose[0] > 2.4  # and it does come near


def test_whoever_walks_away_or_aside_does_not_stop_it() -> None:
    config, robot = SafetyConfig(), Kobuki()
    leaving = robot.people(np.array([[1.0, 0.0]]), np.array([[1.2, 0.0]]))
    assert allowed_factor(0.6, 0.0, NOTHING, leaving, config).factor == 1.0
    aside = robot.people(np.array([[1.5, 1.5]]), np.array([[0.0, 1.0]]))
    assert allowed_factor(0.6, 0.0, NOTHING, aside, config).factor == 1.0
    coming = robot.people(np.array([[1.2, 0.0]]), np.array([[-1.3, 0.0]]))
    assert allowed_factor(0.6, 0.0, NOTHING, coming, config).factor < 0.4


def test_a_frozen_robot_turns_towards_the_freest_direction_and_is_handed_back() -> None:
    """A wall ahead and to the right, free space to the left behind: it turns left until it looks there."""
    front = wall(0.5, 3.0)
    right = np.stack([np.arange(-1.0, 0.5, 0.02), np.full(75, -0.5)], axis=1)
    things = np.concatenate([front, right])
    robot, filter_ = Kobuki(), SafetyFilter()
    actions, now = [], 0.0
    for _ in range(round(20 / 0.05)):
        now += 0.05
        filter_.command(now, 0.5, 0.0)
        filter_.scan(now, "scan", robot.to_robot(things))
        output = filter_.update(now, (robot.pose[0], robot.pose[1]), wants_to_drive=True)
        robot.drive((output.linear_velocity, output.angular_velocity), 0.05)
        actions.append(output.action)
        if "escape" in actions and output.action != "escape":
            break
    started = actions.index("escape") * 0.05
    assert 6.0 <= started <= 8.5  # it drove the first quarter of a metre
    assert actions[-1] != "escape" and robot.pose[2] > 0.8
    assert abs(freest_direction(robot.to_robot(things), NOBODY, 0.26, 3.0)) < 0.2
    place = robot.pose[:2]
    for _ in range(60):  # the way is free now: the one who drives has it back
        now += 0.05
        filter_.command(now, 0.5, 0.0)
        filter_.scan(now, "scan", robot.to_robot(things))
        output = filter_.update(now, (robot.pose[0], robot.pose[1]), wants_to_drive=True)
        robot.drive((output.linear_velocity, output.angular_velocity), 0.05)
    assert math.dist(robot.pose[:2], place) > 0.3


def test_standing_without_a_wish_to_drive_is_not_freezing() -> None:
    filter_ = SafetyFilter()
    for now in np.arange(0.0, 15.0, 0.05):
        filter_.command(now, 0.0, 0.0)
        filter_.scan(now, "scan", NOTHING)
        assert filter_.update(now, (0.0, 0.0)).action == "pass"


def test_points_in_polygons_agree_with_winding_numbers() -> None:
    rng = np.random.default_rng(3)
    star = [(r * math.cos(a), r * math.sin(a)) for a, r in zip(np.arange(10) * math.pi / 5, [1, 0.4] * 5, strict=True)]
    polygon, points = np.array(star), rng.uniform(-1.2, 1.2, (2000, 2))
    offset = polygon[None] - points[:, None]
    angle = np.arctan2(offset[..., 1], offset[..., 0])
    winding = ((np.roll(angle, -1, axis=1) - angle + math.pi) % (2 * math.pi) - math.pi).sum(axis=1)
    np.testing.assert_array_equal(in_polygon(points, polygon), np.abs(winding) > math.pi)


def test_scan_points_are_where_the_rays_end() -> None:
    points = scan_points(np.array([1.0, np.inf, 2.0]), np.array([0.0, 0.1, math.pi / 2]), mount_x_m=0.1)
    np.testing.assert_allclose(points, [[1.1, 0.0], [0.1, 2.0]], atol=1e-12)


def test_its_import_is_light() -> None:
    import subprocess
    import sys

    heavy = ("torch", "numba", "scipy", "gymnasium")
    code = f"import sys, densecavoid.safety; print([m for m in {heavy} if m in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"
