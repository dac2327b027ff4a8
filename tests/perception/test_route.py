"""The next place on the way to the goal: straight where nothing is known, out of dead ends, and a choice that lasts."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from densecavoid.env.observation import Observer, ObserverConfig
from densecavoid.frames import COMMAND_GRID, Command, LidarConfig, Observation, RobotConfig, SensorFrame
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.people import STANDING, TRAVERSING
from densecavoid.sim.spec import Crowd
from densecavoid.sim.world import SimConfig, Simulator
from scene import Scene

LIDAR = LidarConfig()


def observer(route_every_s: float) -> Observer:
    return Observer(ObserverConfig(people_from="detector", route_every_s=route_every_s, threads=1), 1)


def drive_straight_at_what_is_shown(plan: FloorPlan, route_every_s: float, steps: int) -> Simulator:
    """Turns to the goal of the observation, then drives on; the scene's goal is 20 m ahead."""
    sim = Simulator(Scene(plan), 1, SimConfig(threads=1))
    sim.reset(np.zeros(1, np.int64))
    sees = observer(route_every_s)
    for _ in range(steps):
        _, bearing = sees.observe(sim.sense()).goal[0]
        v = 0.5 if abs(bearing) < 0.5 else 0.0
        sim.step(Command(np.array([v], np.float32), np.array([np.clip(2.0 * bearing, -0.4, 0.4)], np.float32)))
        if sim.done[0]:
            break
    return sim


def bay() -> FloorPlan:
    """Open towards the robot, across its way."""
    plan = FloorPlan()
    plan.wall(3.0, -1.5, 3.0, 1.5)
    plan.wall(1.0, 1.5, 3.0, 1.5)
    plan.wall(1.0, -1.5, 3.0, -1.5)
    return plan


def test_a_robot_that_just_follows_it_gets_out_of_a_dead_end() -> None:
    """Though it stands before the open side, and sees the end of it only once it is in."""
    followed = drive_straight_at_what_is_shown(bay(), 0.5, 550)
    assert followed.succeeded[0] and not followed.collided[0]
    without = drive_straight_at_what_is_shown(bay(), 0.0, 550)
    assert without.collided[0]


def test_where_nothing_is_known_it_is_the_goal() -> None:
    sim = Simulator(Scene(FloorPlan()), 1, SimConfig(threads=1))
    sim.reset(np.zeros(1, np.int64))
    shown, plain = observer(0.1), observer(0.0)
    for k in range(40):
        frame = sim.sense()
        goal = shown.observe(frame).goal[0].copy()
        expected = plain.observe(frame).goal[0]
        assert goal[0] == pytest.approx(expected[0], abs=0.01)
        # The place is the middle of a cell 2 m away.
        assert goal[1] == pytest.approx(expected[1], abs=0.06)
        sim.step(Command(np.array([0.5], np.float32), np.array([0.4 if k % 20 < 10 else -0.4], np.float32)))


@pytest.mark.parametrize("walks", [False, True])
def test_who_stands_in_the_way_is_passed_and_who_walks_is_left_to_the_policy(walks: bool) -> None:
    one = np.ones(1)
    pos = np.array([[3.0, 0.1]])
    goal = np.array([[-9.0, 0.1]]) if walks else pos
    mode = np.full(1, TRAVERSING if walks else STANDING)
    crowd = Crowd(pos, goal, 0.4 * one, 0.26 * one, 1.7 * one, mode, heading_rad=math.pi * one)
    sim = Simulator(Scene(FloorPlan(), crowd), 1, SimConfig(threads=1))
    sim.reset(np.zeros(1, np.int64))
    sees, bearing = observer(0.1), 0.0
    for _ in range(25):
        bearing = sees.observe(sim.sense()).goal[0, 1]
        sim.step(Command(np.full(1, 0.0 if walks else 0.4, np.float32), np.zeros(1, np.float32)))
    assert abs(bearing) < 0.05 if walks else 0.15 < abs(bearing) < 0.6


def frame_of_wall(pose: tuple[float, float, float], until_y: tuple[float, float]) -> SensorFrame:
    """What the lidar sees of a wall at x = 2 that reaches from one y to another; the goal is 4 m behind it."""
    x, y, yaw = pose
    angles = LIDAR.angles_rad + yaw
    with np.errstate(divide="ignore"):
        along = np.where(np.cos(angles) > 1e-6, (2.0 - x) / np.cos(angles), np.inf)
    meets = y + along * np.sin(angles)
    scan = np.where((meets > until_y[0]) & (meets < until_y[1]) & (along < LIDAR.max_range_m), along, np.inf)
    return SensorFrame(
        time_s=np.zeros(1),
        scan_m=scan[None].astype(np.float32),
        depth_m=np.full((1, 60, 80), np.inf, np.float32),
        odom_pose=np.array([pose]),
        velocity=np.zeros((1, 2), np.float32),
        goal_odom=np.array([[6.0, 0.0]]),
    )


def bearing_after(poses: list[tuple[float, float, float]], until_y: tuple[float, float] = (-1.0, 1.0)) -> float:
    config = ObserverConfig(people_from="nothing", route_every_s=0.1, threads=1)
    sees, bearing = Observer(config, 1), 0.0
    for pose in poses:
        for _ in range(4):
            bearing = float(sees.observe(frame_of_wall(pose, until_y)).goal[0, 1])
    return bearing


def test_a_choice_lasts_until_another_way_is_clearly_shorter() -> None:
    left, right, far_right = (0.0, 0.15, 0.0), (0.0, -0.15, 0.0), (0.0, -0.9, 0.0)
    assert bearing_after([left]) > 0.2 and bearing_after([right]) < -0.2
    assert bearing_after([left, right]) > 0.2, "it goes on to the left"
    assert bearing_after([left, far_right]) < 0.1, "to the right of the wall it does not go back"


def test_memory_goes_on_where_it_was_saved() -> None:
    config = ObserverConfig(people_from="nothing", route_every_s=0.3, weighs_commands=True, remembers=True, threads=1)
    sees, again = Observer(config, 1), Observer(config, 1)
    poses = [(0.02 * k, 0.15 - 0.01 * k, 0.01 * k) for k in range(30)]
    for pose in poses[:17]:
        sees.observe(frame_of_wall(pose, (-1.0, 1.0)))
    again.load_state_dict(sees.state_dict())
    for pose in poses[17:]:
        frame = frame_of_wall(pose, (-1.0, 1.0))
        one, other = sees.observe(frame), again.observe(frame)
        assert (one.goal == other.goal).all() and (one.worth == other.worth).all()


def test_worlds_that_are_not_marked_keep_their_place() -> None:
    config = ObserverConfig(people_from="nothing", route_every_s=0.1, threads=1)
    sees = Observer(config, 2)
    one = frame_of_wall((0.0, 0.15, 0.0), (-1.0, 1.0))
    both = SensorFrame(
        time_s=np.zeros(2),
        scan_m=one.scan_m.repeat(2, axis=0),
        depth_m=one.depth_m.repeat(2, axis=0),
        odom_pose=one.odom_pose.repeat(2, axis=0),
        velocity=np.zeros((2, 2), np.float32),
        goal_odom=one.goal_odom.repeat(2, axis=0),
    )
    for _ in range(3):
        sees.observe(both)
    before = sees.observe(both).goal.copy()
    assert before[0, 1] == before[1, 1] > 0.2
    sees.reset(np.array([True, False]))
    nothing = frame_of_wall((0.0, 0.15, 0.0), (9.0, 9.0))
    both.scan_m[:] = nothing.scan_m
    after = sees.observe(both, np.array([True, False])).goal
    assert abs(after[0, 1]) < 0.1 and after[1, 1] == before[1, 1]


def test_what_comes_between_is_passed_at_once() -> None:
    sees = Observer(ObserverConfig(people_from="nothing", route_every_s=10.0, threads=1), 1)
    pose = 1.0, 0.1, 0.0
    assert abs(sees.observe(frame_of_wall(pose, (9.0, 9.0))).goal[0, 1]) < 0.1
    assert sees.observe(frame_of_wall(pose, (-1.0, 1.0))).goal[0, 1] > 0.5


def test_another_goal_is_shown_at_once() -> None:
    sees = Observer(ObserverConfig(people_from="nothing", route_every_s=10.0, threads=1), 1)
    frame = frame_of_wall((0.0, 0.0, 0.0), (9.0, 9.0))
    sees.observe(frame)
    frame.goal_odom[0] = 0.0, 5.0
    assert sees.observe(frame).goal[0] == pytest.approx([5.0, math.pi / 2], abs=0.05)


def best_command(observation: Observation) -> tuple[float, float]:
    share, turn = COMMAND_GRID[observation.worth[0].argmax()]
    return float(share), float(turn)


def test_commands_are_weighed_by_what_the_map_and_the_way_say() -> None:
    """Straight where nothing is known, round a wall by the nearer end, and not at all where nobody asks."""
    weighs = ObserverConfig(people_from="nothing", route_every_s=0.1, weighs_commands=True, threads=1)
    open_way, wall = frame_of_wall((0.0, 0.0, 0.0), (9.0, 9.0)), frame_of_wall((1.0, 0.4, 0.0), (-1.0, 1.0))
    assert best_command(Observer(weighs, 1).observe(open_way)) == (1.0, 0.0)
    sees = Observer(weighs, 1)
    for _ in range(2):
        sees.observe(wall)
    seen = sees.observe(wall)
    assert best_command(seen)[1] == 1.0
    assert seen.worth[0].min() >= -0.5 and seen.worth[0].max() < 1.0
    assert not Observer(dataclasses.replace(weighs, weighs_commands=False), 1).observe(wall).worth.any()


def test_a_slower_robot_is_told_what_its_own_commands_are_worth() -> None:
    """The goal is farther off for it, in seconds; to drive there is worth less, and more than to stand."""
    frame, worths = frame_of_wall((0.0, 0.0, 0.0), (9.0, 9.0)), []
    for robot in (RobotConfig(), RobotConfig(max_linear_velocity=0.3)):
        config = ObserverConfig(people_from="nothing", route_every_s=0.1, weighs_commands=True, robot=robot, threads=1)
        worths.append(Observer(config, 1).observe(frame).worth[0].copy())
    straight = [COMMAND_GRID.tolist().index([share, 0.0]) for share in (0.0, 1.0)]
    fast, slow = (worth[straight] for worth in worths)
    assert slow[0] < slow[1] < fast[1] - 0.2 and fast[0] < fast[1]


def test_to_a_goal_that_is_no_place_nothing_is_worth_anything() -> None:
    sees = Observer(ObserverConfig(people_from="nothing", route_every_s=0.1, weighs_commands=True, threads=1), 1)
    frame = frame_of_wall((0.0, 0.0, 0.0), (9.0, 9.0))
    assert sees.observe(frame).worth.any()
    frame.goal_odom[:] = np.nan
    assert not sees.observe(frame).worth.any(), "nor is it what it was before"


def test_settings_that_make_no_sense_are_named() -> None:
    with pytest.raises(ValueError, match="route_every_s"):
        ObserverConfig(route_every_s=-1.0)
    with pytest.raises(ValueError, match="weighs_commands"):
        ObserverConfig(weighs_commands=True)
