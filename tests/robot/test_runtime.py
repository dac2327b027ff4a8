"""The whole loop with a policy that ships: drives, stops and recovers, and says what torch says."""

from __future__ import annotations

import contextlib
import math
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace as Message
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from densecavoid.frames import SensorFrame
from densecavoid.policy.folder_export import export_folder
from densecavoid.robot.config import RobotSettings, load_settings, read_yaml, settings_from
from densecavoid.robot.fault_world import FaultWorld
from densecavoid.robot.faults import ScriptedPilot
from densecavoid.robot.folder import FolderPilot
from densecavoid.robot.messages import Mount
from densecavoid.robot.pilot import InThread
from densecavoid.robot.runtime import RobotRuntime
from densecavoid.robot.transforms import Pose, TransformTree

DT = 0.05


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export_folder("densecavoid", tmp_path_factory.mktemp("export") / "exported")[0]


class Drive:
    """A runtime among the fault world's sensors."""

    def __init__(self, pilot: Any, settings: RobotSettings | None = None) -> None:
        self.world = FaultWorld(np.random.default_rng(0))
        self.runtime = RobotRuntime(pilot, settings or RobotSettings(lidar_mount=Mount()), threaded=False)
        self.steps = 0

    def run(self, seconds: float, *, sensors: bool = True, tf: bool = True) -> Any:
        world, runtime, result = self.world, self.runtime, None
        for _ in range(round(seconds / DT)):
            self.steps += 1
            times = (world.now_s, world.ros_now_s)
            if tf:
                runtime.on_transforms(world.transforms("map", "odom"), world.now_s, False)
            if sensors:
                runtime.on_odom(world.odom(), *times)
                if self.steps % 2 == 0:
                    runtime.on_scan(world.scan(), *times)
                    runtime.on_depth(world.depth(), *times)
            result = runtime.step(*times)
            velocity = (result.command.linear_velocity, result.command.angular_velocity)
            world.drive(velocity if result.command.publish else None, DT)
        return result

    def goal(self, x: float, frame: str = "map") -> str:
        message = self.world.goal()
        message.pose.position.x, message.header.frame_id = x, frame
        return self.runtime.on_goal(message, self.world.now_s)


def test_the_policy_drives_to_a_goal_in_the_map_and_stands_there(folder: Path) -> None:
    drive = Drive(FolderPilot(folder))
    assert "goal" in drive.run(1.0).message
    assert drive.goal(2.5) == ""
    drive.run(6.0)
    step = drive.run(DT)
    assert step.goal_reached and step.message == "goal reached"
    assert math.dist(drive.world.pose[:2], (2.5, 0.0)) < 0.5
    assert drive.world.velocity[0] < 0.05


def test_goals_in_the_robots_frame_are_fixed_where_it_stood_and_lost_ones_stop_it() -> None:
    drive = Drive(ScriptedPilot())
    drive.run(0.5)
    assert drive.goal(4.0, "base_footprint") == ""
    drive.run(4.0)
    assert drive.run(DT).goal_distance_m == pytest.approx(4.0 - drive.world.pose[0], abs=0.1)
    drive.goal(100.0, "map")
    assert drive.run(2.0).fault == ""
    assert drive.run(0.7, tf=False).fault.startswith("goal lost: transform map -> odom is")
    assert drive.run(0.3).fault == ""
    drive.goal(100.0, "nowhere")
    assert drive.run(0.3).fault == "goal lost: no transform odom -> nowhere: they are not connected"
    assert drive.goal(math.nan).startswith("goal is (nan")


def test_a_pilot_that_hangs_is_late_and_what_it_says_at_last_is_not_obeyed() -> None:
    import threading

    release = threading.Event()

    class Slow(ScriptedPilot):
        def act(self, frame: SensorFrame) -> tuple[float, float]:
            release.wait(20)
            return super().act(frame)

    drive = Drive(Slow())
    drive.runtime._worker = worker = InThread(drive.runtime.pilot)
    drive.goal(100.0)
    assert drive.run(2.0).fault == "no command of the policy yet"
    release.set()
    worker._thread.join(0.3)
    assert drive.runtime._worker.poll() is not None
    worker.close()


def test_observations_give_torchs_commands(folder: Path) -> None:
    torch = pytest.importorskip("torch")
    from importlib import resources

    from densecavoid.policy.export import load_safetensors
    from densecavoid.policy.network import ObservationTensors

    with resources.as_file(resources.files("densecavoid.policy") / "weights" / "densecavoid.safetensors") as path:
        network, _ = load_safetensors(path)
    pilot = FolderPilot(folder)
    drive = Drive(pilot)
    drive.goal(100.0)
    drive.run(0.3)
    for _ in range(20):
        step = drive.run(2 * DT)
        assert pilot.observation is not None and step.fault == ""
        with torch.no_grad():
            tensors = ObservationTensors(*(torch.from_numpy(array.copy()) for array in pilot.observation))
            policy = network.policy(tensors)
            drawn = policy.mode if pilot.noise is None else policy.at(torch.from_numpy(pilot.noise).float())
        command = drawn.numpy()[0]
        np.testing.assert_allclose(step.asked, np.clip(command, [0.0, -0.4], [1.0, 0.4]), atol=1e-4)


def test_a_goal_that_is_taken_away_stops_the_robot_and_is_another_than_the_next() -> None:
    drive = Drive(ScriptedPilot())
    drive.run(0.5)
    assert drive.runtime.pose_odom == (0.0, 0.0, 0.0)
    drive.goal(100.0)
    first = drive.runtime.goal_number
    assert drive.run(2.0).command.linear_velocity > 0.1
    drive.runtime.end_goal("nobody wants it")
    step = drive.run(DT)
    assert (step.command.linear_velocity, step.command.angular_velocity) == (0.0, 0.0)
    assert step.message == "nobody wants it" and not step.goal_reached and math.isnan(step.goal_distance_m)
    assert drive.run(2.0).command.linear_velocity == 0.0
    numbers = [first, drive.runtime.goal_number]
    for place in (100.0, math.nan):  # one that is refused is another too
        drive.goal(place)
        numbers.append(drive.runtime.goal_number)
    assert len(set(numbers)) == 4


def test_what_a_robot_imports_is_neither_torch_nor_the_simulator() -> None:
    code = (
        "import sys, densecavoid.robot.runtime, densecavoid.robot.folder, densecavoid.robot.config;"
        # (scipy is imported by numba where it is installed.)
        "heavy = ('torch', 'gymnasium', 'matplotlib', 'densecavoid.sim.world', 'densecavoid.scenarios');"
        "print([name for name in heavy if name in sys.modules])"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"


# -- transforms --------------------------------------------------------------------------------------------------------


def matrix(pose: Pose) -> np.ndarray:
    """In the plane and its height, as a 4 x 4 matrix: an independent way to chain."""
    cos, sin, up = math.cos(pose.yaw), math.sin(pose.yaw), -1.0 if pose.flipped else 1.0
    return np.array([[cos, -sin * up, 0, pose.x], [sin, cos * up, 0, pose.y], [0, 0, up, pose.z], [0, 0, 0, 1]])


def test_transforms_chain_as_matrices_do() -> None:
    rng = np.random.default_rng(1)
    for _ in range(50):
        tree = TransformTree()
        poses = []
        for _ in range(4):
            x, y, z, yaw = (float(value) for value in rng.uniform(-3, 3, 4))
            poses.append(Pose(x, y, z, yaw, bool(rng.integers(2))))
        for pose, (parent, child) in zip(poses, ("ab", "bc", "ad", "de"), strict=True):
            tree.set(parent, f"/{child}", pose)
        wanted = np.linalg.inv(matrix(poses[2]) @ matrix(poses[3])) @ matrix(poses[0]) @ matrix(poses[1])
        np.testing.assert_allclose(matrix(tree.look_up("e", "c", 0.0, 1.0)), wanted, atol=1e-9)


def test_transforms_that_are_old_or_go_round_are_refused() -> None:
    tree = TransformTree()
    tree.set("map", "odom", Pose(1, 0, 0, 0), 5.0, 10.0)
    assert tree.look_up("map", "odom", 10.4, 0.5).x == 1
    with pytest.raises(ValueError, match=r"transform map -> odom is 0\.60 s old"):
        tree.look_up("map", "odom", 10.6, 0.5)
    tree.set("odom", "map", Pose(0, 0, 0, 0))
    with pytest.raises(ValueError, match="circle"):
        tree.look_up("map", "odom", 10.0, 0.5)


# -- files from strangers ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("robot", ["turtlebot2", "turtlebot4"])
def test_robots_that_ship_have_settings(robot: str) -> None:
    assert load_settings(robot).safety.max_linear_velocity <= 0.65


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("a: !!python/object/apply:os.system [true]", "python/object"),
        ("a: &x [1]\nb: *x", "aliases"),
        ("- 1", "mapping"),
        ("odom_frame: 3", "odom_frame"),
        ("use_camera: 'no'", "use_camera"),
        ("control_hz: 1.0e9", "control_hz"),
        ("speed: 3", "no field 'speed'"),
        ("safety: {zones: [{name: z, action: fly, radius_m: 1}]}", "action"),
        ("safety: {zones: [{name: z, action: stop, radius_m: .inf}]}", "radius_m"),
        ("[" * 5000, "nested"),
    ],
)
def test_settings_that_are_wrong_are_refused_by_name(text: str, what: str) -> None:
    with pytest.raises(ValueError, match=what):
        settings_from(read_yaml(text, "robot.yaml"), "robot.yaml")


def test_billions_of_laughs_are_refused_before_they_are_told() -> None:
    text = "a0: &a0 [x, x]\n" + "".join(f"a{i}: &a{i} [*a{i - 1}, *a{i - 1}]\n" for i in range(1, 40))
    with pytest.raises(ValueError, match="aliases"):
        read_yaml(text, "bomb.yaml")


@settings(max_examples=150, deadline=None)
@given(st.one_of(st.text(max_size=200), st.binary(max_size=200).map(lambda raw: raw.decode("latin-1"))))
def test_any_text_is_settings_or_a_value_error(text: str) -> None:
    with contextlib.suppress(ValueError):
        settings_from(read_yaml(text, "fuzz"), "fuzz")


def test_half_dead_scanners_and_covered_cameras_are_named() -> None:
    drive = Drive(ScriptedPilot())
    drive.goal(100.0)
    drive.run(1.0)
    scan, depth = drive.world.scan(), drive.world.depth()
    scan.ranges[30:110] = np.nan
    times = (drive.world.now_s, drive.world.ros_now_s)
    assert "blind over 4" in drive.runtime.on_scan(scan, *times)
    scan.ranges[:] = np.nan
    assert "sees 0% of what is straight ahead" in drive.runtime.on_scan(scan, *times)
    depth.data = bytes(len(depth.data))
    assert "covered?" in drive.runtime.on_depth(depth, *times)
    assert "attribute" in drive.runtime.on_odom(Message(), *times)


def test_a_wall_too_near_for_the_camera_is_no_covered_camera() -> None:
    drive = Drive(ScriptedPilot())
    drive.goal(100.0)
    drive.run(1.0)
    depth, scan = drive.world.depth(), drive.world.scan()
    depth.data = bytes(len(depth.data))
    near = np.abs(scan.angle_min + scan.angle_increment * np.arange(len(scan.ranges))) < 0.6
    scan.ranges[near] = 1.0
    later = drive.world.now_s + 0.05, drive.world.ros_now_s + 0.05
    scan.header.stamp.sec, scan.header.stamp.nanosec = divmod(round(later[1] * 1e9), 10**9)
    depth.header.stamp = scan.header.stamp
    assert "covered?" in drive.runtime.on_depth(depth, *later)
    assert drive.runtime.on_scan(scan, *later) == ""
    assert drive.runtime.on_depth(depth, *later) == ""
