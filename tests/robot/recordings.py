"""Recordings of a simulated robot among people, in every format that a robot writes: scan, depth, odometry, a goal."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Literal

import numpy as np

from densecavoid.baselines import GoToGoal
from densecavoid.frames import SensorFrame
from densecavoid.scenarios import make_scenario
from densecavoid.sim.world import Simulator

Kind = Literal[".bag", ".mcap", ".db3"]
_BEGIN_S = 1000.0
_ROBOT = "base_footprint"


def drive(seconds: float, scenario: str = "random-sparse-ped", seed: int = 3) -> list[SensorFrame]:
    """What the robot sensed, a frame each .1 s, while it went straight to its goal."""
    simulator, navigator = Simulator(make_scenario(scenario), 1), GoToGoal()
    everybody = np.ones(1, np.bool_)
    simulator.reset(np.array([seed]))
    navigator.reset(everybody)
    frames = []
    for _ in range(round(seconds * 10)):
        frame = simulator.sense()
        copies = {
            name: getattr(frame, name).copy()  # the simulator writes its buffers again
            for name in ("time_s", "scan_m", "depth_m", "odom_pose", "velocity", "goal_odom")
        }
        frames.append(SensorFrame(**copies))
        simulator.step(navigator.act(frame))
    return frames


def write_recording(
    path: Path, kind: Kind, frames: list[SensorFrame], camera: bool = True, compression: str = ""
) -> Path:
    """The frames as messages.

    Args:
        path: without an ending.
        kind: .bag is ROS 1's, the others ROS 2's.
        frames: a tenth of a second apart.
        camera: with depth images.
        compression: ROS 1: bz2 or lz4; ROS 2: what is compressed (with zstd): file, message or, in .mcap, storage.

    Returns:
        What is to be opened: a file, or ROS 2's folder.
    """
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    first = kind == ".bag"
    store = get_typestore(Stores.ROS1_NOETIC if first else Stores.ROS2_JAZZY)
    plugin = StoragePlugin.MCAP if kind == ".mcap" else StoragePlugin.SQLITE3
    place = path.with_suffix(".bag") if first else path
    writer: Any = Writer1(place) if first else Writer(place, version=9, storage_plugin=plugin)
    if compression and first:
        writer.set_compression(Writer1.CompressionFormat[compression.upper()])
    elif compression:
        writer.set_compression(CompressionMode[compression.upper()], CompressionFormat.ZSTD)
    with writer:
        connections: dict[str, Any] = {}
        for topic, name, message, time_s in _messages(store, frames, camera, first):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, name, typestore=store)
            raw = store.serialize_ros1(message, name) if first else store.serialize_cdr(message, name)
            writer.write(connections[topic], round(1e9 * time_s), raw)
    return place


def _messages(store: Any, frames: list[SensorFrame], camera: bool, first: bool) -> Any:
    types = store.types
    for number, frame in enumerate(frames):
        time_s = _BEGIN_S + 0.1 * number
        stamp = types["builtin_interfaces/msg/Time"](sec=int(time_s), nanosec=round(1e9 * (time_s % 1.0)))

        def header(frame_id: str, stamp: Any = stamp, number: int = number) -> Any:
            counter = {"seq": number} if first else {}
            return types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame_id, **counter)

        yield "/odom", "nav_msgs/msg/Odometry", _odometry(types, header("odom"), frame), time_s
        if number == 0:
            x, y = frame.goal_odom[0].tolist()
            pose = _pose(types, x, y, 0.0)
            goal = types["geometry_msgs/msg/PoseStamped"](header=header("odom"), pose=pose)
            yield "/goal", "geometry_msgs/msg/PoseStamped", goal, time_s
        if camera:
            depth = frame.depth_m[0]
            height, width = depth.shape
            image = types["sensor_msgs/msg/Image"](
                header=header("camera"),
                height=height,
                width=width,
                encoding="32FC1",
                is_bigendian=0,
                step=4 * width,
                data=np.frombuffer(depth.tobytes(), np.uint8),
            )
            yield "/depth/image", "sensor_msgs/msg/Image", image, time_s
        half = math.radians(120.0)
        scan = types["sensor_msgs/msg/LaserScan"](
            header=header("laser"),
            angle_min=-half,
            angle_max=half,
            angle_increment=2.0 * half / (frame.scan_m.shape[1] - 1),
            time_increment=0.0,
            scan_time=0.1,
            range_min=0.02,
            range_max=4.0,
            ranges=frame.scan_m[0],
            intensities=np.zeros(0, np.float32),
        )
        yield "/scan", "sensor_msgs/msg/LaserScan", scan, time_s


def _pose(types: Any, x: float, y: float, yaw: float) -> Any:
    return types["geometry_msgs/msg/Pose"](
        position=types["geometry_msgs/msg/Point"](x=x, y=y, z=0.0),
        orientation=types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=math.sin(yaw / 2), w=math.cos(yaw / 2)),
    )


def _odometry(types: Any, header: Any, frame: SensorFrame) -> Any:
    vector = types["geometry_msgs/msg/Vector3"]
    linear, angular = frame.velocity[0].tolist()
    twist = types["geometry_msgs/msg/Twist"](
        linear=vector(x=linear, y=0.0, z=0.0), angular=vector(x=0.0, y=0.0, z=angular)
    )
    none = np.zeros(36)
    return types["nav_msgs/msg/Odometry"](
        header=header,
        child_frame_id=_ROBOT,
        pose=types["geometry_msgs/msg/PoseWithCovariance"](
            pose=_pose(types, *frame.odom_pose[0].tolist()), covariance=none
        ),
        twist=types["geometry_msgs/msg/TwistWithCovariance"](twist=twist, covariance=none),
    )
