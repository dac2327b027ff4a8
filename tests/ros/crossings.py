"""The node drives a MuJoCo body through whole crowds over real topics, in the wall's time; prints how that ends.

python tests/ros/crossings.py ros1|ros2 [--scenario dense-ped] [--episodes N] [--json FILE]

Run it with the Python that `make test-ros` runs the tests with; that of the node comes from DENSECAVOID_ROS1 and
DENSECAVOID_ROS2. Worlds are the benchmark's, the robot a Turtlebot 2; recordings: DENSECAVOID_DATA. Where others
use the processor sensors come late, and then the watchdog stops the robot: how often is printed too.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
from collections import Counter
from contextlib import ExitStack
from importlib import resources
from pathlib import Path
from typing import Any

import middleware
import numpy as np

from densecavoid.benchmark.runner import TEST_SEEDS_START
from densecavoid.benchmark.solvable import admit
from densecavoid.benchmark.statistics import wilson_interval
from densecavoid.policy.folder_export import export_folder
from densecavoid.scenarios import make_scenario
from densecavoid.sim.config import SimConfig

_AFTER_S = 2.0
"""The episode's own limit comes first; this is for a body that lags behind the wall's clock."""


def cross(ros: middleware.Ros, scenario: str, seed: int, limit_s: float) -> dict[str, Any]:
    """One episode: how it ended, after how many seconds, and the share of time in which a sensor's fault held it up."""
    script = [("drive", limit_s + _AFTER_S), ("signal-INT", 1.0)]
    log = ros.drive(script, f"crossing-{seed}", "--mujoco", scenario, "--seed", str(seed))
    (begin, _), (end, _) = log["phases"]
    said = [reason for at, reason in log["reasons"] if begin + 1.0 <= at < end]
    held_up = [reason for reason in said if reason.startswith(("scan is", "depth is", "odom is", "policy is"))]
    return {
        "seed": seed,
        "outcome": log["outcome"] or "timeout",
        "duration_s": end - begin,
        "held_up": len(held_up) / max(len(said), 1),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("version", choices=("ros1", "ros2"))
    parser.add_argument("--scenario", default="dense-ped")
    parser.add_argument("--episodes", type=int, default=10)
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    python = os.environ.get(f"DENSECAVOID_{args.version.upper()}")
    if not python:
        parser.error(f"DENSECAVOID_{args.version.upper()} is not set: `make test-ros` shows what it is")
    scenario = make_scenario(args.scenario)
    seeds = admit(scenario, SimConfig(threads=1), TEST_SEEDS_START, args.episodes).seeds
    rows: list[dict[str, Any]] = []
    with ExitStack() as stack:
        tmp = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        folder, _ = export_folder("densecavoid", tmp / "exported")
        if args.version == "ros1":
            ros = stack.enter_context(middleware.ros1(python, folder, "turtlebot2", tmp))
        else:  # the wheels have no TF
            shipped = (resources.files("densecavoid.robot") / "robots" / "turtlebot2.yaml").read_text("utf-8")
            robot = tmp / "robot.yaml"
            robot.write_text(shipped + "use_tf: false\nlidar_mount: {x_m: 0.0}\n", encoding="utf-8")
            ros = middleware.ros2(python, folder, str(robot), tmp)
        for seed in seeds:
            limit_s = scenario.spawn(np.random.default_rng(seed)).time_limit_s
            rows.append(cross(ros, args.scenario, seed, limit_s))
            print("{seed} {outcome:10}{duration_s:6.1f} s, held up {held_up:.0%}".format(**rows[-1]), flush=True)
    outcomes = Counter(row["outcome"] for row in rows)
    low, high = wilson_interval(outcomes["success"], len(rows))
    share = outcomes["success"] / len(rows)
    print(
        f"{args.version}, {args.scenario}: success {share:.2f} [{low:.2f}, {high:.2f}] of {len(rows)}, {dict(outcomes)}"
    )
    if args.json:
        args.json.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
