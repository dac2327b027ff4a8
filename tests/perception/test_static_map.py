"""What stands is on the map where it stands, whoever walks by, and goes when it is seen to have gone."""

from __future__ import annotations

import math

import numpy as np
import pytest

from densecavoid.baselines.surroundings import PeopleAround
from densecavoid.frames import CameraConfig, Command, LidarConfig, RobotConfig
from densecavoid.perception.people_around import People
from densecavoid.perception.rolling_grid import CELL_M
from densecavoid.perception.static_map import StaticMap
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.people import TRAVERSING
from densecavoid.sim.spec import Crowd
from densecavoid.sim.world import SimConfig, Simulator
from scene import Scene


def drive(scene: Scene, commands: list[tuple[float, float, int]], camera: CameraConfig = CameraConfig()):
    """Drives (m/s, rad/s, steps); gives the map's points in the world and the pose at the end."""
    sim = Simulator(scene, 1, SimConfig(threads=1, camera=camera))
    sim.reset(np.zeros(1, np.int64))
    seen, around = StaticMap(LidarConfig(), camera, RobotConfig(), 1, 1), PeopleAround(camera=camera)
    around.reset(np.ones(1, np.bool_))
    look(sim, seen, around)
    for v, w, steps in commands:
        for _ in range(steps):
            sim.step(Command(np.array([v], np.float32), np.array([w], np.float32)))
            look(sim, seen, around)
    return in_world(sim, seen), sim.robot_pose[0]


def look(sim: Simulator, seen: StaticMap, around: PeopleAround) -> None:
    frame = sim.sense()
    seen.update(frame, around.see(frame), np.ones(1, np.bool_))


def in_world(sim: Simulator, seen: StaticMap) -> np.ndarray:
    x, y, yaw = sim.robot_pose[0]
    points = seen.points[0, : seen.count[0]].astype(float)
    turned = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
    return points @ turned.T + [x, y]


def test_a_wall_stays_where_it_is_while_the_robot_drives_and_turns() -> None:
    plan = FloorPlan()
    plan.wall(-4.0, 2.0, 8.0, 2.0)
    points, pose = drive(Scene(plan), [(1.0, 0.0, 20), (0.3, -0.4, 40)])
    assert pose[2] < -1.5  # it looks away by now
    face = points[:, 1]
    assert len(points) > 30
    # Walls have a thickness; rays end at its near face.
    assert np.ptp(face) < 0.02 and abs(face.mean() - 2.0) < 0.12
    assert np.ptp(points[:, 0]) > 5.0


@pytest.mark.parametrize("pitch_rad", [0.0, 0.25])
def test_a_table_is_known_when_neither_sensor_sees_its_top_any_more(pitch_rad: float) -> None:
    plan = FloorPlan()
    plan.table(3.0, 0.3, 0.8, 1.2)
    points, _ = drive(Scene(plan), [(0.5, 0.0, 34)], CameraConfig(mount_pitch_rad=pitch_rad))
    front = points[np.abs(points[:, 0] - 2.6) < 0.1]
    # Its legs, at the corners, could be the lidar's; what is between them can only be the camera's.
    between = front[np.abs(front[:, 1] - 0.3) < 0.35]
    assert len(between) >= 6
    assert (points[:, 1] < 0.3 + 0.6 + CELL_M).all() and (points[:, 1] > 0.3 - 0.6 - CELL_M).all()


def test_who_walks_leaves_no_trail() -> None:
    one = np.ones(1)
    place, goal = np.array([[3.0, -1.5]]), np.array([[3.0, 9.0]])
    crowd = Crowd(place, goal, 0.6 * one, 0.26 * one, 1.7 * one, np.full(1, TRAVERSING), heading_rad=1.5 * one)
    points, _ = drive(Scene(FloorPlan(), crowd), [(0.0, 0.0, 80)])
    assert len(points) == 0


def test_what_is_gone_is_cleared_and_what_is_known_of_one_world_is_not_of_another() -> None:
    plan = FloorPlan()
    plan.pillar(2.0, 0.0, 0.2)
    here, empty = (Simulator(Scene(p), 1, SimConfig(threads=1)) for p in (plan, FloorPlan()))
    for sim in (here, empty):
        sim.reset(np.zeros(1, np.int64))
    seen = StaticMap(LidarConfig(), CameraConfig(), RobotConfig(), 1, 1)
    nobody = People(np.zeros((1, 1, 2)), np.zeros((1, 1, 2)), np.zeros((1, 1)), np.zeros((1, 1), np.bool_), np.zeros(1))

    def see(sim: Simulator, times: int) -> None:
        for _ in range(times):
            seen.update(sim.sense(), nobody, np.ones(1, np.bool_))

    see(here, 10)
    assert seen.count[0] > 3
    see(empty, 5)
    assert seen.count[0] == 0
    see(here, 10)
    seen.reset(np.ones(1, np.bool_))
    assert seen.count[0] == 0
