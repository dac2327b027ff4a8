"""Recordings without ROS: ROS 1 `.bag` and ROS 2 `.db3` or `.mcap` in, MCAP out, by rosbags. A file is taken for what a
stranger sent: sizes are checked, and what cannot be read is left out and counted.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from densecavoid.frames import require
from densecavoid.robot.bag_limits import bound_unpacking
from densecavoid.robot.runtime import Step

MAX_BAG_BYTES = 64 << 30
_KINDS = {
    "sensor_msgs/msg/LaserScan": "scan",
    "sensor_msgs/msg/Image": "depth",
    "sensor_msgs/msg/CameraInfo": "camera_info",
    "nav_msgs/msg/Odometry": "odom",
    "geometry_msgs/msg/PoseStamped": "goal",
    "tf2_msgs/msg/TFMessage": "tf",
}


class Recorded(NamedTuple):
    """One message of a recording that the loop can use."""

    kind: str
    """scan, depth, camera_info, odom, goal, tf or tf_static."""
    topic: str
    time_s: float
    """When it was received, by the recorder's clock."""
    message: Any


class Topics(NamedTuple):
    """Which topic of a recording plays which part; empty: none."""

    scan: str = ""
    depth: str = ""
    camera_info: str = ""
    odom: str = ""
    goal: str = ""


def _rosbags() -> Any:
    try:
        from rosbags import highlevel
    except ModuleNotFoundError as error:
        raise ValueError(f"recordings need {error.name}: pip install 'densecavoid[robot]'") from None
    bound_unpacking(MAX_BAG_BYTES)
    return highlevel


class Bag:
    """A recording, open for reading. Use as a context."""

    def __init__(self, path: Path) -> None:
        """
        Raises:
            ValueError: if it is none that can be read, saying why.
        """
        highlevel = _rosbags()
        if not path.exists():
            raise ValueError(f"no recording at {path}")
        parts = [path] if path.is_file() else [part for part in path.iterdir() if part.is_file()]
        size = sum(part.stat().st_size for part in parts)
        require(0 < size <= MAX_BAG_BYTES, f"size of {path}", size, f"at most {MAX_BAG_BYTES} bytes")
        self.path = path
        try:
            from rosbags.typesys import Stores, get_typestore

            # A ROS 2 file may lack its definitions: then those of a distribution are taken.
            self._reader = highlevel.AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY))
            self._reader.open()
        except Exception as error:  # rosbags' errors, and those of its decoders on broken files
            raise ValueError(f"{path} is no recording that can be read: {type(error).__name__}: {error}") from error
        self.unreadable = 0
        """Messages left out so far."""

    def __enter__(self) -> Bag:
        return self

    def __exit__(self, *error: object) -> None:
        self._reader.close()

    def topics_of(self, kind: str) -> list[str]:
        """Topics with messages of that kind, the fullest first."""
        connections = [c for c in self._reader.connections if _KINDS.get(c.msgtype) == kind]
        return [c.topic for c in sorted(connections, key=lambda c: -c.msgcount)]

    def choose(self, wanted: Topics) -> Topics:
        """The topics asked for, and for the others the fullest of their kind.

        Raises:
            ValueError: if one that was asked for is not there, or there is no scan.
        """
        chosen = {}
        for kind, topic in wanted._asdict().items():
            known = self.topics_of(kind)
            if topic and topic not in known:
                raise ValueError(f"{self.path} has no {kind} {topic!r}, expected one of: {', '.join(known) or 'none'}")
            if kind == "depth" and not topic:
                known = [name for name in known if "depth" in name]
            chosen[kind] = topic or (known[0] if known else "")
        if not chosen["scan"]:
            raise ValueError(f"{self.path} has no LaserScan")
        return Topics(**chosen)

    def messages(self, topics: Topics) -> Iterator[Recorded]:
        """All messages of those topics, and transforms, in order of time.

        Raises:
            ValueError: if the file breaks off in the middle.
        """
        wanted = {topic for topic in topics if topic}
        connections = [c for c in self._reader.connections if c.topic in wanted or _KINDS.get(c.msgtype) == "tf"]
        stream = self._reader.messages(connections=connections)
        while True:
            try:
                connection, time_ns, raw = next(stream)
            except StopIteration:
                return
            except Exception as error:
                raise ValueError(f"{self.path} breaks off: {type(error).__name__}: {error}") from error
            try:
                message = self._reader.deserialize(raw, connection.msgtype)
            except Exception:  # whatever a broken message makes of its reader
                self.unreadable += 1
                continue
            kind = _KINDS[connection.msgtype]
            if kind == "tf" and connection.topic.endswith("tf_static"):
                kind = "tf_static"
            yield Recorded(kind, connection.topic, 1e-9 * time_ns, message)


class Recorder:
    """Writes MCAP that Foxglove and `ros2 bag` open. Use as a context."""

    def __init__(self, path: Path) -> None:
        """
        Args:
            path: a folder to be made, as rosbag2 has it: the file in it, and metadata.yaml.

        Raises:
            ValueError: if it exists.
        """
        _rosbags()
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.typesys import Stores, get_typestore

        if path.exists():
            raise ValueError(f"{path} exists already")
        self._store = get_typestore(Stores.ROS2_JAZZY)
        self._writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
        self._writer.open()
        self._connections: dict[str, Any] = {}

    def __enter__(self) -> Recorder:
        return self

    def __exit__(self, *error: object) -> None:
        self._writer.close()

    def _write(self, topic: str, kind: str, time_s: float, message: Any) -> None:
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(topic, kind, typestore=self._store)
        raw = self._store.serialize_cdr(message, kind)
        self._writer.write(self._connections[topic], int(1e9 * time_s), raw)

    def _header(self, time_s: float, frame: str) -> Any:
        types = self._store.types
        seconds = math.floor(time_s)
        stamp = types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=int(1e9 * (time_s - seconds)))
        return types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)

    def velocity(self, time_s: float, linear: float, angular: float, frame: str) -> None:
        """A command, as TwistStamped on `cmd_vel`."""
        types = self._store.types
        vector = types["geometry_msgs/msg/Vector3"]
        twist = types["geometry_msgs/msg/Twist"](
            linear=vector(x=float(linear), y=0.0, z=0.0), angular=vector(x=0.0, y=0.0, z=float(angular))
        )
        kind = "geometry_msgs/msg/TwistStamped"
        self._write("/cmd_vel", kind, time_s, types[kind](header=self._header(time_s, frame), twist=twist))

    def scan(self, time_s: float, message: Any) -> None:
        """A LaserScan of ROS 1, ROS 2 or rosbags, on `scan`."""
        kind = "sensor_msgs/msg/LaserScan"
        numbers = {
            name: float(getattr(message, name))
            for name in (
                "angle_min",
                "angle_max",
                "angle_increment",
                "time_increment",
                "scan_time",
                "range_min",
                "range_max",
            )
        }
        copy = self._store.types[kind](
            header=self._header(time_s, message.header.frame_id),
            ranges=np.asarray(message.ranges, np.float32),
            intensities=np.asarray(message.intensities, np.float32),
            **numbers,
        )
        self._write("/scan", kind, time_s, copy)

    def step(self, time_s: float, step: Step, frame: str) -> None:
        """What the loop decided, and why."""
        self.velocity(time_s, step.command.linear_velocity, step.command.angular_velocity, frame)
        self.status(time_s, step.level, step.message)

    def status(self, time_s: float, level: int, message: str) -> None:
        """Why the robot does what it does, on `diagnostics`."""
        types = self._store.types
        status = types["diagnostic_msgs/msg/DiagnosticStatus"](
            level=level, name="densecavoid", message=message, hardware_id="", values=[]
        )
        kind = "diagnostic_msgs/msg/DiagnosticArray"
        self._write("/diagnostics", kind, time_s, types[kind](header=self._header(time_s, ""), status=[status]))
