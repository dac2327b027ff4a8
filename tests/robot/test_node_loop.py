"""The nodes' loop behind a simulated body: its messages lose nothing, and it drives as a navigator does."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from densecavoid.benchmark.rollout import run_episodes
from densecavoid.frames import CameraConfig, Navigator
from densecavoid.policy.folder_export import export_folder
from densecavoid.robot import messages
from densecavoid.robot.config import load_settings
from densecavoid.robot.drivers import Drivers
from densecavoid.robot.node_loop import NodeLoop
from densecavoid.scenarios import make_scenario
from densecavoid.scenarios.corridor import corridor_plan
from densecavoid.sim.config import SimConfig
from densecavoid.sim.spec import WorldSpec
from densecavoid.sim.world import Simulator

CONFIG = SimConfig(threads=1)


@dataclass(frozen=True)
class EmptyCorridor:
    """A corridor with nobody in it."""

    name: str = "empty-corridor"

    def spawn(self, rng: np.random.Generator) -> WorldSpec:
        return WorldSpec(self.name, corridor_plan(4.0, 12.0), (1.0, 0.0, 0.0), (5.0, 0.3), time_limit_s=20.0)


@pytest.fixture(scope="module")
def loop(tmp_path_factory: pytest.TempPathFactory) -> NodeLoop:
    folder: Path = export_folder("densecavoid", tmp_path_factory.mktemp("export") / "exported")[0]
    return NodeLoop(folder, load_settings("turtlebot2"), CONFIG.lidar, CONFIG.camera)


def test_messages_come_back_as_the_frame_they_were_made_of() -> None:
    simulator = Simulator(make_scenario("dense-ped"), 1, CONFIG)
    simulator.reset(np.array([3]))
    frame, drivers = simulator.sense(), Drivers(CONFIG.lidar, CONFIG.camera)
    scan = messages.scan_from_ros(drivers.scan(frame, 12.25))
    assert (scan.stamp_s, scan.frame) == (12.25, "laser")
    ranges = messages.clean_ranges(scan)
    resampled, seen = messages.resample_scan(scan, ranges, messages.Mount(), CONFIG.lidar)
    assert seen.all()
    np.testing.assert_allclose(resampled, frame.scan_m[0], rtol=1e-6)
    intrinsics = messages.intrinsics_from_ros(drivers.camera_info(12.25))
    image = messages.depth_from_ros(drivers.depth(frame, 12.25))
    np.testing.assert_allclose(image.depth_m, frame.depth_m[0], atol=5.1e-4)  # whole millimetres
    np.testing.assert_array_equal(messages.DepthResampler(CONFIG.camera)(image, intrinsics)[0], image.depth_m[0])
    odometry = messages.odometry_from_ros(drivers.odom(frame, 12.25))
    assert odometry.pose == pytest.approx(frame.odom_pose[0].tolist(), abs=1e-12)
    assert odometry.velocity == pytest.approx(frame.velocity[0].tolist())
    assert messages.goal_from_ros(drivers.goal(frame, 12.25)).pos == pytest.approx(frame.goal_odom[0].tolist())


def test_drives_to_the_goal_within_the_robots_limits_and_again_after_a_reset(loop: NodeLoop) -> None:
    assert isinstance(loop, Navigator)
    simulator = Simulator(EmptyCorridor(), 1, replace(CONFIG, control_dt_s=loop.control_dt_s))
    episodes = run_episodes(simulator, loop, [1, 2])
    for episode in episodes:
        assert episode.outcome == "success", loop.reasons
        assert 0.3 < episode.command[:, 0].max() <= 0.65 + 1e-6  # the Turtlebot 2's settings, not the policy's 1 m/s
        assert np.abs(episode.command[:, 1]).max() <= 0.4 + 1e-6
    np.testing.assert_array_equal(episodes[0].command, episodes[1].command)  # nothing is kept from one to the next
    assert set(loop.reasons) <= {"driving", "limits of the robot"}  # no sensor was refused, nothing came late


def test_drives_a_body_whose_camera_sits_elsewhere(tmp_path: Path) -> None:
    camera = CameraConfig(160, 120, min_range_m=0.3, mount_height_m=0.6, mount_pitch_rad=0.2, mount_x_m=0.1)
    folder: Path = export_folder("densecavoid", tmp_path / "exported")[0]
    loop = NodeLoop(folder, load_settings("turtlebot2"), CONFIG.lidar, camera)
    body = replace(CONFIG, camera=camera, control_dt_s=loop.control_dt_s)
    episodes = run_episodes(Simulator(EmptyCorridor(), 1, body), loop, [1])
    assert episodes[0].outcome == "success", loop.reasons
    assert set(loop.reasons) <= {"driving", "limits of the robot"}


def test_refuses_more_than_one_world(loop: NodeLoop) -> None:
    with pytest.raises(ValueError, match="worlds"):
        loop.reset(np.ones(2, np.bool_))
