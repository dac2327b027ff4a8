"""What both nodes are started with. Imports no ROS."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class NodeConfig:
    """A node's command line; ROS's own arguments (`--ros-args ...`, `topic:=name`) are handed on to ROS."""

    folder: Path = Path("exported")
    """Exported folder."""
    robot: str = "turtlebot2"
    """Settings: a robot that ships, or a YAML file."""
    autostart: bool = True
    """ROS 2: configure and activate itself; otherwise a lifecycle manager does."""
    record: Path | None = None
    """Writes what comes in and goes out to this MCAP file."""
