"""The robot's loop: time from sensor messages to command, difference from torch, time and memory of a start.

python benchmarks/robot.py [--json FILE] [--steps N]

A recorded episode (`dense-ped`, 15 people) is turned into ROS-like messages (a scan of 720 rays, a depth image of
640 x 480 in millimetres, odometry) and fed to the loop on one thread. The same observations go through torch, where it
is installed.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from densecavoid.frames import CameraConfig, LidarConfig, Observation
from densecavoid.policy.folder_export import export_folder
from densecavoid.robot.config import settings_from
from densecavoid.robot.drivers import Drivers
from densecavoid.robot.folder import FolderPilot
from densecavoid.robot.runtime import RobotRuntime

_START = """
import time
begin, cpu = time.perf_counter(), time.process_time()
import densecavoid.robot.runtime, densecavoid.robot.folder
wall, cpu = time.perf_counter() - begin, time.process_time() - cpu
from pathlib import Path
pilot = densecavoid.robot.folder.FolderPilot(Path({folder!r}))
from densecavoid.robot.config import RobotSettings
densecavoid.robot.runtime.RobotRuntime(pilot, RobotSettings(), threaded=False).warm_up()
import sys
ready = time.perf_counter() - begin
# Not getrusage: its peak begins with the parent's.
peak = [line for line in open("/proc/self/status") if line.startswith("VmHWM")][0].split()[1]
print(wall, cpu, ready, int(peak) / 1024, "torch" in sys.modules)
"""


def record(steps: int) -> list[dict[str, Any]]:
    """Messages of an episode, driven by the shipped policy with its own sensors."""
    from densecavoid.policy.navigator import load_policy
    from densecavoid.scenarios import make_scenario
    from densecavoid.sim.world import SimConfig, Simulator

    lidar = LidarConfig(num_rays=720, fov_rad=np.radians(270.0), max_range_m=10.0)
    camera = CameraConfig(width=640, height=480)
    shown = Simulator(make_scenario("dense-ped"), 1, SimConfig(lidar=lidar, camera=camera, threads=1))
    driven = Simulator(make_scenario("dense-ped"), 1, SimConfig(threads=1))
    for simulator in (shown, driven):
        simulator.reset(np.array([7], np.int64))
    navigator = load_policy("densecavoid")
    drivers = Drivers(lidar, camera)
    messages = []
    for step in range(steps):
        frame, now = shown.sense(), 100.0 + 0.1 * step
        messages.append(
            {
                "now": now,
                "scan": drivers.scan(frame, now),
                "depth": drivers.depth(frame, now),
                "odom": drivers.odom(frame, now),
                "goal": drivers.goal(frame, now),
            }
        )
        command = navigator.act(driven.sense())
        for simulator in (shown, driven):
            simulator.step(command)
    return messages


class Acted(NamedTuple):
    """One act of the policy."""

    observation: Observation
    noise: np.ndarray | None
    """What the command was drawn with; none if it is the likeliest."""
    command: np.ndarray


def drive(folder: Path, messages: list[dict[str, Any]]) -> tuple[np.ndarray, list[Acted]]:
    """Feeds the messages to the loop.

    Returns:
        times (ms) by the wall and of this thread, and what the policy made of them.
    """
    settings = settings_from({"use_tf": False, "safety": {"freeze": {"enabled": False}}}, "benchmark")
    pilot = FolderPilot(folder)
    runtime = RobotRuntime(pilot, settings, threaded=False)
    runtime.warm_up()
    times, acted = [], []
    for index, message in enumerate(messages):
        now = message["now"]
        if index == 0:
            runtime.on_odom(message["odom"], now - 0.001, now)
            runtime.on_goal(message["goal"], now)
            runtime.on_odom(message["odom"], now, now)
        begin, cpu = time.perf_counter(), time.thread_time()
        runtime.on_odom(message["odom"], now, now)
        runtime.on_depth(message["depth"], now, now)
        runtime.on_scan(message["scan"], now, now)
        step = runtime.step(now, now)
        times.append((1e3 * (time.perf_counter() - begin), 1e3 * (time.thread_time() - cpu)))
        observation = pilot.observation
        if observation is not None and not step.fault:
            kept = Observation(*(array.copy() for array in observation))
            acted.append(Acted(kept, pilot.noise, np.array(step.asked)))
    return np.array(times), acted


def difference_from_torch(acted: list[Acted]) -> float | None:
    """Greatest difference of a command (m/s, rad/s) from the torch network's; None without torch."""
    try:
        import torch

        from densecavoid.policy.export import load_safetensors
        from densecavoid.policy.network import ObservationTensors
    except ModuleNotFoundError:
        return None
    with resources.as_file(resources.files("densecavoid.policy") / "weights" / "densecavoid.safetensors") as path:
        network, _ = load_safetensors(path)
    worst = 0.0
    with torch.no_grad():
        for observation, noise, command in acted:
            policy = network.policy(ObservationTensors(*map(torch.from_numpy, observation)))
            expected = policy.mode if noise is None else policy.at(torch.from_numpy(noise).float())
            worst = max(worst, float(np.abs(expected.numpy()[0] - command).max()))
    return worst


def start_up(folder: Path) -> dict[str, float]:
    """Import and memory of a fresh process, the least of five: others' work on the computer only adds."""
    rows = []
    for _ in range(5):
        done = subprocess.run(
            [sys.executable, "-c", _START.format(folder=str(folder))], capture_output=True, text=True, check=True
        )
        *numbers, torch = done.stdout.split()
        assert torch == "False", "torch was imported"
        rows.append([float(number) for number in numbers])
    wall, cpu, ready, rss = np.array(rows).min(axis=0)
    return {"import_s": wall, "import_cpu_s": cpu, "ready_s": ready, "rss_mb": rss}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--steps", type=int, default=300)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder_name:
        folder, _ = export_folder("densecavoid", Path(folder_name) / "exported")
        times, acted = drive(folder, record(args.steps))
        result: dict[str, float | None] = {
            "act_ms_p50": float(np.percentile(times[:, 0], 50)),
            "act_ms_p99": float(np.percentile(times[:, 0], 99)),
            # Of the thread alone: what the step costs where nobody else wants the processor.
            "act_cpu_ms_p50": float(np.percentile(times[:, 1], 50)),
            "act_cpu_ms_p99": float(np.percentile(times[:, 1], 99)),
            "difference_from_torch": difference_from_torch(acted),
            **start_up(folder),
        }
    result["commands"] = float(len(acted))
    for name, value in result.items():
        print(f"{name:24} {'-' if value is None else f'{value:.6g}'}")
    if args.json:
        args.json.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
