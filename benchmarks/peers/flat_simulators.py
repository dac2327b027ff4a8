"""Steps a second of IR-SIM, a flat robot simulator from PyPI, with people and a lidar but no depth camera.

The other flat simulators of crowd navigation (robot_sf, social-jym, gym-collision-avoidance) are not on PyPI in a form
that installs beside this package, so their figures are not made here.
"""

from __future__ import annotations

import importlib
import json
import tempfile
import time
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from densecavoid.frames import LidarConfig


def irsim_world(people: int, obstacles: int, side_m: float, lidar: LidarConfig) -> dict[str, Any]:
    """IR-SIM's description of a square with a robot, people who avoid each other, and things standing about."""
    low, high = [1.0, 1.0, -3.14], [side_m - 1.0, side_m - 1.0, 3.14]
    anywhere = {"name": "random", "range_low": low, "range_high": high}
    walk = {"name": "rvo", "wander": True, "range_low": low, "range_high": high, "vxmax": 0.5, "vymax": 0.5}
    scanner = {
        "name": "lidar2d",
        "range_min": 0.0,
        "range_max": lidar.max_range_m,
        "angle_range": lidar.fov_rad,
        "number": lidar.num_rays,
        "noise": False,
    }
    return {
        "world": {
            "height": side_m,
            "width": side_m,
            "step_time": 0.1,
            "sample_time": 0.1,
            "offset": [0, 0],
            "collision_mode": "unobstructed",
        },
        "robot": [
            {
                "kinematics": {"name": "diff"},
                "shape": {"name": "circle", "radius": 0.18},
                "state": [2, 2, 0],
                "goal": [side_m - 2, side_m - 2, 0],
                "sensors": [scanner],
            }
        ],
        "obstacle": [
            {
                "number": people,
                "distribution": anywhere,
                "kinematics": {"name": "omni"},
                "behavior": walk,
                "shape": {"name": "circle", "radius": 0.255},
            },
            {"number": obstacles // 2, "distribution": anywhere, "shape": {"name": "circle", "radius": 0.2}},
            {
                "number": obstacles - obstacles // 2,
                "distribution": anywhere,
                "shape": {"name": "rectangle", "length": 0.5, "width": 0.4},
            },
        ],
    }


def irsim_steps_per_s(people: int, obstacles: int, side_m: float, lidar: LidarConfig, seconds: float) -> float:
    """Median over five spells of steps of one world with its lidar.

    Raises:
        ModuleNotFoundError: if IR-SIM is not installed (`pip install ir-sim`).
    """
    irsim: Any = importlib.import_module("irsim")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "world.yaml"
        path.write_text(json.dumps(irsim_world(people, obstacles, side_m, lidar)), encoding="utf-8")  # JSON is YAML
        env = irsim.make(str(path), display=False, disable_all_plot=True, log_level="ERROR")
    command = np.array([[0.3], [0.1]])
    rates = []
    for spell in range(6):
        count, start = 0, time.perf_counter()
        while time.perf_counter() - start < seconds / 5:
            env.step(command)
            env.get_lidar_scan()
            count += 1
        if spell:  # the first one warms up
            rates.append(count / (time.perf_counter() - start))
    return median(rates)
