"""A robot's settings: frames, limits, sensors. Read from YAML without any code in it; every value is checked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import yaml

from densecavoid.frames import RobotConfig, choose, require
from densecavoid.networks.config_json import from_dict
from densecavoid.robot.camera_mount import CameraMount
from densecavoid.robot.messages import Mount
from densecavoid.safety.config import SafetyConfig

MAX_YAML_BYTES = 256 * 1024
_MAX_DEPTH = 12


@dataclass(frozen=True)
class RobotSettings:
    """Everything about one robot that the exported policy does not know."""

    base_frame: str = "base_footprint"
    odom_frame: str = "odom"
    use_camera: bool = True
    """False: a robot with a lidar alone; the camera's image is empty then."""
    use_tf: bool = True
    """Goals in other frames, and where scanner and camera sit, from TF; otherwise from their mounts below."""
    lidar_mount: Mount | None = None
    """Where the scanner sits; without it, from TF."""
    camera_mount: CameraMount | None = None
    """Where the depth camera sits; without it, from TF; where that does not know it, where the policy's camera sat."""
    scan_frame: str = ""
    """Frame that scans must have; empty: that of the first."""
    depth_frame: str = ""
    zero_range: Literal["invalid", "nothing"] = "invalid"
    """What a range of exactly 0 stands for."""
    ignore_within_m: float = 0.0
    """Returns nearer to the scanner than this are the robot's own body: as if nothing were there."""
    control_hz: float = 20.0
    """Rate of the filter and of cmd_vel."""
    policy_hz: float = 10.0
    """Rate of the policy, as in its training."""
    max_age_s: float = 0.3
    """Older sensors stop the robot."""
    max_transform_age_s: float = 0.5
    goal_tolerance_m: float = 0.3
    min_lidar_share: float = 0.5
    """Share of the policy's rays straight ahead (45 degrees either way) that the scanner must really see."""
    max_blind_rad: float = 0.35
    """The widest gap of invalid rays within 90 degrees either way of straight ahead; more: the scanner is half dead."""
    min_depth_share: float = 0.02
    """Share of pixels with depth (the floor has some, unless a wall hides it); less: the camera is covered."""
    enable_stamped_cmd_vel: bool = False
    """TwistStamped instead of Twist."""
    safety: SafetyConfig = field(default_factory=SafetyConfig)

    def __post_init__(self) -> None:
        for name in ("base_frame", "odom_frame"):
            require(bool(getattr(self, name)), f"RobotSettings.{name}", getattr(self, name), "not empty")
        choose("zero_range", self.zero_range, ("invalid", "nothing"))
        for name in ("control_hz", "policy_hz"):
            value = getattr(self, name)
            require(1.0 <= value <= 200.0, f"RobotSettings.{name}", value, "in [1, 200] Hz")
        require(self.policy_hz <= self.control_hz, "policy_hz", self.policy_hz, "at most control_hz")
        for name in ("max_age_s", "max_transform_age_s", "goal_tolerance_m", "max_blind_rad"):
            value = getattr(self, name)
            require(0 < value <= 10, f"RobotSettings.{name}", value, "in (0, 10]")
        require(0 <= self.ignore_within_m <= 2, "ignore_within_m", self.ignore_within_m, "in [0, 2] m")
        for name in ("min_lidar_share", "min_depth_share"):
            value = getattr(self, name)
            require(0 <= value <= 1, f"RobotSettings.{name}", value, "in [0, 1]")

    @property
    def robot(self) -> RobotConfig:
        """Whom the policy drives, behind the filter."""
        linear, angular = self.safety.max_linear_velocity, self.safety.max_angular_velocity
        return RobotConfig(max_linear_velocity=linear, max_angular_velocity=angular)


class _StrictLoader(yaml.SafeLoader):
    """Plain values only, no aliases: a few bytes of aliases can stand for gigabytes."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("aliases are not allowed")
        self.depth = getattr(self, "depth", 0) + 1
        if self.depth > _MAX_DEPTH:
            raise yaml.YAMLError(f"nested deeper than {_MAX_DEPTH}")
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node


def read_yaml(text: str, source: str) -> dict[str, Any]:
    """A YAML file's mapping of plain values.

    Raises:
        ValueError: if it is too large, no mapping, or has anything but plain values in it.
    """
    require(len(text) <= MAX_YAML_BYTES, f"size of {source}", len(text), f"at most {MAX_YAML_BYTES} bytes")
    try:
        values = yaml.load(text, _StrictLoader)
    except (yaml.YAMLError, ValueError, RecursionError, OverflowError) as error:
        raise ValueError(f"{source}: {error}") from error
    except (TypeError, AttributeError, KeyError, IndexError) as error:  # PyYAML's, on odd tags and keys
        raise ValueError(f"{source}: not plain YAML: {error}") from error
    if values is None:
        return {}
    if not isinstance(values, dict) or not all(isinstance(key, str) for key in values):
        raise ValueError(f"{source} is a {type(values).__name__}, expected a mapping of names to values")
    return values


def settings_from(values: Mapping[str, Any], source: str) -> RobotSettings:
    """Settings from plain values.

    Raises:
        ValueError: naming the file and the value that is wrong.
    """
    try:
        return from_dict(RobotSettings, dict(values))
    except (TypeError, ValueError, AttributeError, KeyError, IndexError) as error:
        raise ValueError(f"{source}: {error}") from error


def load_settings(name_or_path: str | Path) -> RobotSettings:
    """The settings of a robot that ships (`turtlebot2`, `turtlebot4`) or of a YAML file.

    Raises:
        ValueError, OSError: if there is none, or it is wrong.
    """
    path = Path(name_or_path)
    shipped = {file.stem: file for file in (Path(__file__).parent / "robots").glob("*.yaml")}
    if str(name_or_path) in shipped and not path.is_file():
        path = shipped[str(name_or_path)]
    elif not path.is_file():
        raise ValueError(f"no robot {str(name_or_path)!r}: not a file, nor one of: {', '.join(sorted(shipped))}")
    require(path.stat().st_size <= MAX_YAML_BYTES, f"size of {path}", path.stat().st_size, "a settings file's")
    try:
        text = path.read_text("utf-8")
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: not UTF-8 text: {error}") from error
    return settings_from(read_yaml(text, str(path)), str(path))
