"""The nodes over real middleware: they drive, stop with a reason, go on by themselves, and end with zero.

`make test-ros` installs both ROS versions and runs this; without them (DENSECAVOID_ROS1, DENSECAVOID_ROS2: the Python
to run each with) the tests are skipped.
"""

from __future__ import annotations

import itertools
import json
import os
import socket
import subprocess
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

pytest.importorskip("rosbags")
from rosbags.highlevel import AnyReader

from densecavoid.policy.folder_export import export_folder

ROOT = Path(__file__).resolve().parents[2]
PROFILE = ROOT / "ros" / "densecavoid_ros2" / "config" / "fastdds_large_images.xml"
DRIVE_S = 4.0


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@dataclass
class Ros:
    """One ROS version, ready to start nodes."""

    version: str
    python: str
    environment: dict[str, str]
    folder: Path
    robot: Path
    tmp: Path

    def drive(self, script: list[tuple[str, float]], name: str) -> dict[str, list]:
        """Starts a node and a body, lets the script run, and returns what the body received."""
        out, node_log = self.tmp / f"{name}.json", self.tmp / f"{name}.log"
        node_args = [self.version, "--folder", str(self.folder), "--robot", str(self.robot)]
        node_args += ["--record", str(self.tmp / f"{name}-recording")]
        if self.version == "ros1":
            node_args += ["cmd_vel:=cmd_vel_mux/input/navi"]
        else:
            node_args += ["--ros-args", "-r", "cmd_vel:=commands/velocity"]
        with node_log.open("w") as log:
            node = subprocess.Popen(
                [self.python, "-m", "densecavoid.cli", "robot", *node_args],
                env=self.environment,
                stdout=log,
                stderr=log,
            )
        try:
            body = [self.python, str(ROOT / "tests" / "ros" / "body.py"), self.version, "--pid", str(node.pid)]
            done = subprocess.run(
                [*body, "--out", str(out), "--script", json.dumps(script)],
                env=self.environment,
                timeout=100,
                capture_output=True,
                text=True,
            )
            assert done.returncode == 0, f"{done.stderr[-2000:]}\nnode:\n{node_log.read_text()[-2000:]}"
            if script[-1][0].startswith("signal-"):
                assert node.wait(20) in (0, 130), node_log.read_text()[-2000:]
        finally:
            if node.poll() is None:
                node.kill()
                node.wait()
        log = json.loads(out.read_text())
        with AnyReader([self.tmp / f"{name}-recording"]) as reader:
            counts = {connection.topic: connection.msgcount for connection in reader.connections}
        assert counts["/scan"] > 10 and counts["/cmd_vel"] > 20, counts
        log["node"] = node_log.read_text()
        return log


def environment(**changes: str) -> dict[str, str]:
    kept = {key: value for key, value in os.environ.items() if not key.startswith("_ROS_WHEELS")}
    return kept | {"PYTHONPATH": str(ROOT / "src"), "OMP_NUM_THREADS": "1"} | changes


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export_folder("densecavoid", tmp_path_factory.mktemp("export") / "exported")[0]


@pytest.fixture(scope="module")
def ros1(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Ros]:
    python = os.environ.get("DENSECAVOID_ROS1")
    if not python:
        pytest.skip("no ROS 1: `make test-ros` installs it and sets DENSECAVOID_ROS1")
    tmp, port = tmp_path_factory.mktemp("ros1"), free_port()
    variables = environment(
        ROS_MASTER_URI=f"http://127.0.0.1:{port}", ROS_IP="127.0.0.1", ROS_HOME=str(tmp), ROS_LOG_DIR=str(tmp)
    )
    system = variables | {"PATH": "/usr/bin:/bin", "PYTHONPATH": ""}
    core = subprocess.Popen(
        ["/usr/bin/roscore", "-p", str(port)], env=system, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        for _ in range(200):
            with socket.socket() as probe:
                if probe.connect_ex(("127.0.0.1", port)) == 0:
                    break
            time.sleep(0.1)
        else:
            pytest.fail("roscore did not start within 20 s")
        robot = tmp / "robot.yaml"
        robot.write_text("base_frame: base_footprint\n")
        yield Ros("ros1", python, variables, folder, robot, tmp)
    finally:
        core.terminate()
        core.wait(20)


@pytest.fixture(scope="module")
def ros2(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Ros:
    python = os.environ.get("DENSECAVOID_ROS2")
    if not python:
        pytest.skip("no ROS 2: `make test-ros` installs it and sets DENSECAVOID_ROS2")
    tmp = tmp_path_factory.mktemp("ros2")
    variables = environment(
        ROS_DOMAIN_ID=str(40 + os.getpid() % 60),
        ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST",
        FASTDDS_DEFAULT_PROFILES_FILE=str(PROFILE),
        ROS_LOG_DIR=str(tmp),
    )
    robot = tmp / "robot.yaml"
    robot.write_text("use_tf: false\nlidar_mount: {x_m: 0.0}\n")
    return Ros("ros2", python, variables, folder, robot, tmp)


def check(log: dict[str, list], version: str) -> None:
    """Drives in each `drive` phase's second half; in each fault phase zero comes within .6 s, with a reason that names
    it; never over the limits; the last words after a signal are zeros."""
    phases = [*log["phases"], (log["end"], "end")]
    for (begin, phase), (end, _) in itertools.pairwise(phases):
        commands = [command for command in log["commands"] if begin <= command[0] < end]
        reasons = {reason for at, reason in log["reasons"] if begin + 0.6 <= at < end}
        if phase == "drive":
            late = [command for command in commands if command[0] > begin + 2.0]
            assert late, f"{version}: no command in a drive phase; {log['reasons'][-5:]}\n{log['node'][-1500:]}"
            assert max(command[1] for command in late) > 0.1, f"{phase}: {late[-5:]} {log['reasons'][-5:]}"
        elif phase.startswith("no-"):
            moving = [at - begin for at, linear, angular in commands if linear != 0 or angular != 0]
            assert not moving or max(moving) <= 0.6, f"{phase}: still moving after {max(moving):.2f} s"
            word = {"no-tf": "goal lost: transform map -> odom"}.get(phase, f"{phase.removeprefix('no-')} is ")
            assert any(word in reason for reason in reasons), f"{phase}: {reasons}"
        else:
            assert commands, f"{phase}: nothing was sent"
            assert commands[-1][1:] == [0.0, 0.0], f"{phase}: the last words are {commands[-3:]}"
            moving = [at - begin for at, linear, angular in commands if linear != 0 or angular != 0]
            print(f"{version} {phase}: zero after {1e3 * (commands[-1][0] - begin):.0f} ms")
            assert not moving or max(moving) <= 0.6
    for _, linear, angular in log["commands"]:
        assert 0.0 <= linear <= 1.0 and abs(angular) <= 0.4 + 1e-6


FAULTS = [("drive", DRIVE_S), ("no-scan", 1.2), ("drive", 3.0), ("no-depth", 1.2), ("drive", 3.0), ("no-odom", 1.2)]


@pytest.mark.timeout(150)
def test_ros_1_drives_stops_and_says_zero_on_sigint(ros1: Ros) -> None:
    script = [*FAULTS, ("drive", 3.0), ("no-tf", 1.4), ("drive", 3.0), ("signal-INT", 1.0)]
    check(ros1.drive(script, "faults"), "ros1")


@pytest.mark.timeout(100)
def test_ros_1_says_zero_on_sigterm(ros1: Ros) -> None:
    check(ros1.drive([("drive", DRIVE_S), ("signal-TERM", 1.0)], "term"), "ros1")


@pytest.mark.timeout(150)
def test_ros_2_drives_stops_and_says_zero_on_sigint(ros2: Ros) -> None:
    check(ros2.drive([*FAULTS, ("drive", 3.0), ("signal-INT", 1.0)], "faults"), "ros2")


@pytest.mark.timeout(100)
def test_ros_2_says_zero_on_sigterm(ros2: Ros) -> None:
    check(ros2.drive([("drive", DRIVE_S), ("signal-TERM", 1.0)], "term"), "ros2")
