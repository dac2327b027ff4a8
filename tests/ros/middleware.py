"""Both versions of ROS, ready to let a node drive a body: what the tests and crossings.py start."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from ros2_messages import CANNOT_BUILD
from rosbags.highlevel import AnyReader

ROOT = Path(__file__).resolve().parents[2]
PROFILE = ROOT / "ros" / "densecavoid_ros2" / "config" / "fastdds_large_images.xml"


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
    robot: str
    tmp: Path

    def drive(
        self, script: list[tuple[str, float]], name: str, *options: str, program: str = "body.py"
    ) -> dict[str, Any]:
        """Starts a node and a body (`program`) with these options, lets the script run, and returns what the body
        received."""
        out, node_log = self.tmp / f"{name}.json", self.tmp / f"{name}.log"
        node_args = [self.version, "--folder", str(self.folder), "--robot", self.robot]
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
            body = [self.python, str(ROOT / "tests" / "ros" / program), self.version, "--pid", str(node.pid)]
            done = subprocess.run(
                [*body, "--out", str(out), "--script", json.dumps(script), *options],
                env=self.environment,
                timeout=120 + sum(seconds for _, seconds in script),
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
            log["recorded"] = {connection.topic: connection.msgcount for connection in reader.connections}
        log["node"] = node_log.read_text()
        return log


def environment(**changes: str) -> dict[str, str]:
    kept = {key: value for key, value in os.environ.items() if not key.startswith("_ROS_WHEELS")}
    return kept | {"PYTHONPATH": str(ROOT / "src"), "OMP_NUM_THREADS": "1"} | changes


@contextmanager
def ros1(python: str, folder: Path, robot: str, tmp: Path) -> Iterator[Ros]:
    """ROS 1 with a master of its own.

    Args:
        python: to run node and body with.
        folder: exported.
        robot: settings: a robot that ships, or a file.
        tmp: where logs go.
    """
    port = free_port()
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
            raise TimeoutError("roscore did not start within 20 s")
        yield Ros("ros1", python, variables, folder, robot, tmp)
    finally:
        core.terminate()
        core.wait(20)


def python_of(version: str) -> str:
    """The Python that has ROS 1 or 2 (`version`); the test that asks is skipped where there is none."""
    python = os.environ.get(f"DENSECAVOID_ROS{version}")
    if not python:
        pytest.skip(f"no ROS {version}: `make test-ros` installs it and sets DENSECAVOID_ROS{version}")
    return python


def build_messages(python: str) -> Path:
    """The messages that ROS 2's wheels lack, built once for each environment (some seconds).

    Raises:
        FileNotFoundError: if what a build takes (compiler, Python's headers) is not there; it says what.
        RuntimeError: with the build's words, if it fails.
    """
    script = ROOT / "tests" / "ros" / "ros2_messages.py"
    done = subprocess.run([python, str(script)], env=environment(), capture_output=True, text=True, timeout=300)
    if done.returncode == CANNOT_BUILD:
        raise FileNotFoundError(done.stderr.strip().splitlines()[-1])
    if done.returncode:
        raise RuntimeError(done.stderr[-4000:])
    return Path(done.stdout.strip())


def ros2(python: str, folder: Path, robot: str, tmp: Path, messages: Path | None = None) -> Ros:
    """ROS 2 in a domain of its own; arguments as for `ros1`.

    Args:
        messages: what ros2_messages.py has built; without it there is no TF and no action.
    """
    variables = environment(
        ROS_DOMAIN_ID=str(40 + os.getpid() % 60),
        ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST",
        FASTDDS_DEFAULT_PROFILES_FILE=str(PROFILE),
        ROS_LOG_DIR=str(tmp),
    )
    if messages is not None:
        variables["PYTHONPATH"] += f"{os.pathsep}{messages}"
        libraries = filter(None, (str(messages), variables.get("LD_LIBRARY_PATH")))
        variables["LD_LIBRARY_PATH"] = os.pathsep.join(libraries)
    return Ros("ros2", python, variables, folder, robot, tmp)
