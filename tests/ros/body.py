"""A robot behind real topics, for the tests of the nodes: publishes sensors, obeys cmd_vel, follows a script of faults
and signals, and writes down everything it receives. A process of its own, because ROS 2's wheels start Python anew.

python body.py ros1|ros2 --pid NODE --out FILE --script '[["drive", 3], ["no-scan", 1.5], ["signal-INT", 1]]'
    [--mujoco SCENARIO --seed N]

The body is the fault world's, or a scenario's world in MuJoCo; its script ends when its episode does.
"""

# pyright: reportMissingImports=false

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
import time
from array import array
from collections.abc import Callable
from typing import Any

import numpy as np

from densecavoid.frames import CameraConfig, LidarConfig
from densecavoid.robot.drivers import Drivers
from densecavoid.robot.fault_world import FaultWorld

TOPICS: tuple[str, ...] = ("scan", "depth/image", "depth/camera_info", "odom", "goal_pose")
START_LIMIT_S = 90.0
DEPTH_SCALE = 16  # the world's 40 x 30 pixels become 640 x 480


class Log:
    """Everything received, with the time since the start."""

    def __init__(self) -> None:
        self.start_s = time.monotonic()
        self.commands: list[tuple[float, float, float]] = []
        self.reasons: list[tuple[float, str]] = []
        self.phases: list[tuple[float, str]] = []
        self.sensors: dict[str, str] = {}
        """What the node said last of each of them."""
        self.sent: dict[str, int] = dict.fromkeys(TOPICS, 0)
        """How many messages of each topic, before any signal."""

    def now(self) -> float:
        return time.monotonic() - self.start_s


class Ros1:
    """Topics by rospy."""

    stamped = False

    def __init__(self, log: Log, world: FaultWorld) -> None:
        sys.path.append("/usr/lib/python3/dist-packages")
        import rospy
        from diagnostic_msgs.msg import DiagnosticArray
        from geometry_msgs.msg import PoseStamped, TransformStamped, Twist
        from nav_msgs.msg import Odometry
        from sensor_msgs.msg import CameraInfo, Image, LaserScan
        from tf2_msgs.msg import TFMessage

        self.rospy, self.world = rospy, world
        self.kinds: dict[str, Any] = dict(
            zip(TOPICS, (LaserScan, Image, CameraInfo, Odometry, PoseStamped), strict=True)
        )
        self.transform, self.tf_message = TransformStamped, TFMessage
        rospy.init_node("body", disable_signals=True)
        self.publishers = {
            topic: rospy.Publisher(topic, kind, queue_size=1, tcp_nodelay=True) for topic, kind in self.kinds.items()
        }
        self.tf = rospy.Publisher("/tf", TFMessage, queue_size=10)
        rospy.Subscriber("cmd_vel_mux/input/navi", Twist, lambda m: took(log, world, m), tcp_nodelay=True)
        rospy.Subscriber("/diagnostics", DiagnosticArray, lambda m: heard(log, m))

    def ready(self) -> bool:
        return all(publisher.get_num_connections() > 0 for publisher in self.publishers.values())

    def spin(self, seconds: float) -> None:
        time.sleep(seconds)

    def clock_s(self) -> float:
        return self.rospy.get_time()

    def publish(self, topic: str, plain: Any) -> None:
        message = self.kinds[topic]()
        fill(message, plain)
        self.publishers[topic].publish(message)

    def send_transforms(self) -> None:
        made = []
        for parent, child in (("map", "odom"), ("base_footprint", "laser")):
            transform = self.transform()
            fill(transform, self.world.transforms(parent, child)[0])
            made.append(transform)
        self.tf.publish(self.tf_message(made))


class Ros2:
    """Topics by rclpy."""

    def __init__(self, log: Log, world: FaultWorld) -> None:
        import rclpy
        from diagnostic_msgs.msg import DiagnosticArray
        from geometry_msgs.msg import PoseStamped, Twist
        from nav_msgs.msg import Odometry
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.qos import qos_profile_sensor_data
        from sensor_msgs.msg import CameraInfo, Image, LaserScan

        rclpy.init(args=[])
        self.node = rclpy.create_node("body")
        self.kinds: dict[str, Any] = dict(
            zip(TOPICS, (LaserScan, Image, CameraInfo, Odometry, PoseStamped), strict=True)
        )
        sensors = dict.fromkeys(TOPICS[:3], qos_profile_sensor_data)
        self.publishers = {
            topic: self.node.create_publisher(kind, topic, sensors.get(topic, 10)) for topic, kind in self.kinds.items()
        }
        self.node.create_subscription(Twist, "commands/velocity", lambda m: took(log, world, m), 10)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", lambda m: heard(log, m), 10)
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)

    def ready(self) -> bool:
        return all(publisher.get_subscription_count() > 0 for publisher in self.publishers.values())

    def spin(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.executor.spin_once(timeout_sec=max(0.0, end - time.monotonic()))

    def clock_s(self) -> float:
        return self.node.get_clock().now().nanoseconds * 1e-9

    def publish(self, topic: str, plain: Any) -> None:
        message = self.kinds[topic]()
        fill(message, plain)
        self.publishers[topic].publish(message)

    def send_transforms(self) -> None:
        """The wheels have no tf2_msgs."""


def took(log: Log, world: FaultWorld, message: Any) -> None:
    command = (message.linear.x, message.angular.z)
    log.commands.append((log.now(), *command))
    world._command, world._commanded_s = command, world.now_s


def heard(log: Log, message: Any) -> None:
    status = message.status[0]
    log.reasons.append((log.now(), status.message))
    log.sensors = {pair.key: pair.value for pair in status.values}


def fill(message: Any, plain: Any) -> None:
    """Copies the values of a plain message into ROS's; ROS 1 names the parts of a stamp and K differently."""
    for name, value in vars(plain).items():
        if not hasattr(message, name):
            name = {"sec": "secs", "nanosec": "nsecs", "k": "K"}[name]
        if hasattr(value, "__dict__"):
            fill(getattr(message, name), value)
        elif isinstance(value, np.ndarray):
            setattr(message, name, value.tolist())
        elif name == "data" and hasattr(message, "_data"):
            message._data = array("B", value)  # rclpy checks every byte of anything else
        else:
            setattr(message, name, value)


class LargeImages(FaultWorld):
    """The fault world with depth images of 640 x 480, and a camera that says so."""

    outcome = ""
    """It has no end."""

    def depth(self) -> Any:
        depth = super().depth()
        small = np.frombuffer(depth.data, "<u2").reshape(30, 40)
        big = np.kron(small, np.ones((DEPTH_SCALE, DEPTH_SCALE), np.uint16)).astype("<u2")
        depth.width, depth.height, depth.step, depth.data = 640, 480, 1280, big.tobytes()
        return depth

    def camera_info(self) -> Any:
        return Drivers(LidarConfig(), CameraConfig(width=640, height=480)).camera_info(self.ros_now_s)


def make_world(scenario: str | None, seed: int) -> Any:
    """The fault world, or a scenario's in MuJoCo."""
    if scenario is None:
        return LargeImages(np.random.default_rng(seed))
    from mujoco_body import MujocoBody  # the other one needs no MuJoCo

    return MujocoBody(scenario, seed)


def wait_for_node(pid: int, ros: Ros1 | Ros2, is_ready: Callable[[], bool]) -> None:
    """Spins until the node is there; one that has to compile its kernels first takes most of a minute."""
    deadline = time.monotonic() + START_LIMIT_S
    while not is_ready():
        os.kill(pid, 0)  # raises if the node is gone
        if time.monotonic() > deadline:
            sys.exit(f"the node did not listen within {START_LIMIT_S:.0f} s")
        ros.spin(0.1)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("version", choices=("ros1", "ros2"))
    parser.add_argument("--pid", type=int, required=True)
    parser.add_argument("--out", required=True)
    parser.add_argument("--script", required=True)
    parser.add_argument("--mujoco", metavar="SCENARIO")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    log, world = Log(), make_world(args.mujoco, args.seed)
    ros = (Ros1 if args.version == "ros1" else Ros2)(log, world)

    def send(topic: str, plain: Any) -> None:
        ros.publish(topic, plain)
        log.sent[topic] += not phase.startswith("signal-")

    world.now_s, world.clock_offset_s = time.monotonic(), ros.clock_s() - time.monotonic()
    wait_for_node(args.pid, ros, ros.ready)
    ros.spin(0.5)
    goal_frame = "map" if args.version == "ros1" else "odom"
    step, phase = 0, ""
    for phase, seconds in json.loads(args.script):
        log.phases.append((log.now(), phase))
        if phase.startswith("signal-"):
            os.kill(args.pid, getattr(signal, "SIG" + phase.removeprefix("signal-")))
        if phase == "drive" and step == 0:
            goal = world.goal()
            goal.header.frame_id = goal_frame
            for _ in range(5):  # odometry first: the goal may be looked at without it, but the robot stands
                world.now_s = time.monotonic()
                send("odom", world.odom())
                ros.send_transforms()
                ros.spin(0.02)
            send("goal_pose", goal)
        end = time.monotonic() + seconds
        while time.monotonic() < end and (phase != "drive" or not world.outcome):
            step += 1
            begin = time.monotonic()
            world.drive(None, begin - world.now_s)
            if step % 2 == 0 and phase != "no-scan":
                send("scan", world.scan())
            if step % 2 == 0 and phase != "no-depth":
                send("depth/camera_info", world.camera_info())
                send("depth/image", world.depth())
            if phase != "no-odom":
                send("odom", world.odom())
            if phase != "no-tf":
                ros.send_transforms()
            ros.spin(max(0.0, 0.05 - (time.monotonic() - begin)))
    told = {name: getattr(log, name) for name in ("commands", "reasons", "phases", "sent", "sensors")}
    told |= {"end": log.now(), "outcome": world.outcome, "pose": list(map(float, world.pose))}
    with open(args.out, "w") as file:
        json.dump(told, file)


if __name__ == "__main__":
    main()
