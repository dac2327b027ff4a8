"""`densecavoid export`, `robot` and `replay`: the command lines of this room."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from densecavoid._verbs import Verb, run_verb
from densecavoid.perception.networks import SHIPPED_DETECTOR

if TYPE_CHECKING:
    from densecavoid.robot.replay import ReplayConfig, ReplaySummary

_DEBIAN = Path("/usr/lib/python3/dist-packages")


@dataclass(frozen=True)
class ExportConfig:
    """A policy as the folder that robots run."""

    policy: str = "densecavoid"
    """A policy that ships, or an ONNX file."""
    out: Path = Path("exported")
    """The folder."""
    detector: str = SHIPPED_DETECTOR
    """Who finds people in depth images: a detector that ships, or an ONNX file."""
    predictor: str | None = None
    """Who foresees them, for a policy that was trained with a learned predictor; without it, the one that ships."""


def export(args: Sequence[str]) -> None:
    """write the folder that robots run: networks, configuration, checksums"""
    from densecavoid.policy.folder_export import export_folder

    config = tyro.cli(ExportConfig, prog="densecavoid export", args=args)
    folder, notes = export_folder(config.policy, config.out, config.detector, config.predictor)
    for note in notes:
        print(f"note: {note}")
    print(folder)


def _node_arguments(args: Sequence[str]) -> tuple[list[str], list[str]]:
    """Our arguments, and ROS's: from `--ros-args` on, and `name:=value`."""
    cut = list(args).index("--ros-args") if "--ros-args" in args else len(args)
    ours, ros = list(args[:cut]), list(args[cut:])
    return [arg for arg in ours if ":=" not in arg], [arg for arg in ours if ":=" in arg] + ros


def _ros1(args: Sequence[str]) -> None:
    """the ROS 1 node"""
    from densecavoid.robot.node_config import NodeConfig

    ours, ros = _node_arguments(args)
    config = tyro.cli(NodeConfig, prog="densecavoid robot ros1", args=ours)
    if importlib.util.find_spec("rospy") is None and (_DEBIAN / "rospy").is_dir():
        sys.path.append(str(_DEBIAN))  # last, so that this environment's own NumPy wins
    try:
        from densecavoid.robot.ros1 import run
    except ModuleNotFoundError as error:
        raise ValueError(f"the ROS 1 node needs {error.name}: source ROS's setup, or install python3-rospy") from None
    run(config, ros)


def _ros2(args: Sequence[str]) -> None:
    """the ROS 2 node"""
    from densecavoid.robot.node_config import NodeConfig

    ours, ros = _node_arguments(args)
    config = tyro.cli(NodeConfig, prog="densecavoid robot ros2", args=ours)
    try:
        from densecavoid.robot.ros2 import run
    except ModuleNotFoundError as error:
        raise ValueError(f"the ROS 2 node needs {error.name}: source ROS's setup.bash") from None
    run(config, ros)


def _faults(args: Sequence[str]) -> None:
    """inject faults by the thousand into the robot's loop, and print what came of them"""
    from densecavoid.robot.faults import FaultsConfig, run_faults, table

    print(table(run_faults(tyro.cli(FaultsConfig, prog="densecavoid robot faults", args=args))))


def replay(args: Sequence[str], run: Callable[[ReplayConfig], ReplaySummary]) -> None:
    """Runs a recording with `run`, which may film it, and prints what came of it."""
    from densecavoid.robot.replay import ReplayConfig

    config = tyro.cli(ReplayConfig, prog="densecavoid replay", args=args)
    summary = run(config)
    print(
        f"{summary.scans} scans in {summary.seconds:.1f} s, {summary.commands} commands, {summary.moving_share:.0%} of "
        f"them moving, at most {summary.people_most} people; {summary.act_ms_p50:.2f} ms a step (p99 "
        f"{summary.act_ms_p99:.2f}) -> {config.out}"
    )
    for name, counts in (("said", summary.reasons), ("refused", summary.refused)):
        for word, count in sorted(counts.items(), key=lambda item: -item[1])[:6]:
            print(f"  {name} {count:6} x {word}")


ROBOT: dict[str, Verb] = {"ros1": _ros1, "ros2": _ros2, "faults": _faults}
"""What `densecavoid robot` can do."""


def robot(args: Sequence[str]) -> None:
    """drive a robot: the ROS 1 node, the ROS 2 node, the fault campaign"""
    run_verb("densecavoid robot", ROBOT, args)
