"""Promises of the go-to-goal navigator, on frames made by hand and in the simulator."""

from __future__ import annotations

import math

import numpy as np
import pytest

from densecavoid.baselines import GoToGoal
from densecavoid.baselines.go_to_goal import braking_speed
from densecavoid.benchmark.rollout import run_episodes
from densecavoid.frames import LidarConfig, RobotConfig, SensorFrame
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.spec import WorldSpec
from densecavoid.sim.world import SimConfig, Simulator


def frame_towards(goals: list[tuple[float, float]], yaw_rad: float = 0.0, scan_m: float = np.inf) -> SensorFrame:
    """One world a goal; robots at (1, 2)."""
    worlds = len(goals)
    pose = np.tile([1.0, 2.0, yaw_rad], (worlds, 1))
    return SensorFrame(
        time_s=np.zeros(worlds),
        scan_m=np.full((worlds, 512), scan_m, np.float32),
        depth_m=np.full((worlds, 60, 80), np.nan, np.float32),
        odom_pose=pose,
        velocity=np.zeros((worlds, 2), np.float32),
        goal_odom=np.array(goals) + np.array([1.0, 2.0]),
    )


def test_turns_towards_the_goal_and_no_faster_than_the_robot_may():
    command = GoToGoal().act(frame_towards([(5, 0), (5, 5), (5, -5), (-5, 0.1), (5, 0.5)]))
    assert command.angular_velocity[:4] == pytest.approx([0.0, 0.4, -0.4, 0.4])
    assert 0 < command.angular_velocity[4] < 0.4


def test_heading_counts_in_the_turn():
    command = GoToGoal().act(frame_towards([(0, 5)], yaw_rad=math.pi))
    assert command.angular_velocity[0] == pytest.approx(-0.4)


def test_is_fastest_straight_ahead_and_stands_while_the_goal_is_behind():
    straight, aside, behind, near = (
        GoToGoal().act(frame_towards([(5, 0), (4, 3), (-5, 0), (0.5, 0)])).linear_velocity.tolist()
    )
    assert straight == pytest.approx(1.0)
    assert 0 < aside < straight
    assert behind == pytest.approx(0.0)
    assert near == pytest.approx(0.5)


def test_drives_no_arc_that_circles_the_goal():
    """At v and w_max the robot's circle has radius v / w_max; a goal inside of it would never be met."""
    goals = [(0.6 * math.cos(b), 0.6 * math.sin(b)) for b in np.linspace(0.05, 1.5, 12)]
    speeds = GoToGoal().act(frame_towards(goals)).linear_velocity
    for (x, y), speed in zip(goals, speeds, strict=True):
        radius = speed / RobotConfig().max_angular_velocity
        assert math.hypot(x, y - radius) >= radius - 1e-6


def test_stops_for_what_is_ahead_and_not_for_what_is_beside():
    angles = LidarConfig().angles_rad
    frame = frame_towards([(5, 0)] * 3)
    frame.scan_m[0, np.abs(angles).argmin()] = 0.5
    frame.scan_m[1, np.abs(angles - math.pi / 2).argmin()] = 0.4
    frame.scan_m[2, np.abs(angles).argmin()] = 0.8
    ahead, beside, coming = GoToGoal().act(frame).linear_velocity
    assert ahead == 0.0
    assert beside == pytest.approx(1.0)
    assert 0 < coming < 1.0


def test_may_still_turn_when_stopped():
    frame = frame_towards([(5, 5)])
    frame.scan_m[:] = 0.45
    command = GoToGoal().act(frame)
    assert command.linear_velocity[0] == 0.0
    assert command.angular_velocity[0] == pytest.approx(0.4)


@pytest.mark.parametrize("distance_m", [0.05, 0.3, 1.0, 4.0])
def test_braking_speed_stops_within_the_distance(distance_m: float):
    """Simulated: full speed for the reaction time, then braking."""
    speed = float(braking_speed(np.array([distance_m]), 1.0, 0.2)[0])
    driven, velocity, dt = speed * 0.2, speed, 1e-4
    while velocity > 0:
        driven += velocity * dt
        velocity -= 1.0 * dt
    assert driven == pytest.approx(distance_m, abs=2e-3)


def test_refuses_a_scan_of_another_lidar():
    with pytest.raises(ValueError, match=r"512.*256"):
        GoToGoal(lidar=LidarConfig(num_rays=256)).act(frame_towards([(5, 0)]))


class Walled:
    """A goal behind a wall, or before it."""

    name = "walled"

    def __init__(self, wall_x: float) -> None:
        self.wall_x = wall_x

    def spawn(self, rng: np.random.Generator) -> WorldSpec:
        plan = FloorPlan()
        plan.wall(self.wall_x, -3, self.wall_x, 3)
        return WorldSpec("walled", plan, (0.0, 0.0, 0.3), (4.0, 0.0), time_limit_s=20.0)


@pytest.mark.parametrize("dynamics", ["ideal", "dynamic"])
def test_stops_before_a_wall_and_reaches_a_free_goal(dynamics):
    config = SimConfig(dynamics=dynamics)
    (blocked,) = run_episodes(Simulator(Walled(2.0), 1, config), GoToGoal(), [1])
    assert blocked.outcome == "timeout"
    # The wall's near face is at 1.95, and the robot may come as near to it as .55 m.
    assert 1.2 < blocked.pose_w[-1, 0] < 1.45
    assert blocked.velocity[-1, 0] < 0.02
    (free,) = run_episodes(Simulator(Walled(5.5), 1, config), GoToGoal(), [1])
    assert free.outcome == "success"
    assert free.duration_s < 8
