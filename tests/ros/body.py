"""A robot behind real topics, for the tests of the nodes: publishes sensors, obeys cmd_vel, follows a script of faults
and signals, and writes down everything it receives. A process of its own, because ROS 2's wheels start Python anew.

python body.py ros1|ros2 --pid NODE --out FILE --script '[["drive", 3], ["no-scan", 1.5], ["signal-INT", 1]]'
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
from typing import Any

import numpy as np

from densecavoid.robot.fault_world import FaultWorld

DEPTH_SCALE = 16  # the world's 40 x 30 pixels become 640 x 480


class Log:
    """Everything received, with the time since the start."""

    def __init__(self) -> None:
        self.start_s = time.monotonic()
        self.commands: list[tuple[float, float, float]] = []
        self.reasons: list[tuple[float, str]] = []
        self.phases: list[tuple[float, str]] = []
        self.delays_ms: list[float] = []

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
        from sensor_msgs.msg import Image, LaserScan
        from tf2_msgs.msg import TFMessage

        self.rospy, self.world = rospy, world
        self.kinds = {"scan": LaserScan, "depth/image": Image, "odom": Odometry, "goal_pose": PoseStamped}
        self.transform, self.tf_message = TransformStamped, TFMessage
        rospy.init_node("body", disable_signals=True)
        self.publishers = {
            topic: rospy.Publisher(topic, kind, queue_size=1, tcp_nodelay=True) for topic, kind in self.kinds.items()
        }
        self.tf = rospy.Publisher("/tf", TFMessage, queue_size=10)
        rospy.Subscriber("cmd_vel_mux/input/navi", Twist, lambda m: took(log, world, m), tcp_nodelay=True)
        rospy.Subscriber(
            "/diagnostics", DiagnosticArray, lambda m: log.reasons.append((log.now(), m.status[0].message))
        )

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
        from sensor_msgs.msg import Image, LaserScan

        rclpy.init(args=[])
        self.node = rclpy.create_node("body")
        self.kinds = {"scan": LaserScan, "depth/image": Image, "odom": Odometry, "goal_pose": PoseStamped}
        sensors = {"scan": qos_profile_sensor_data, "depth/image": qos_profile_sensor_data}
        self.publishers = {
            topic: self.node.create_publisher(kind, topic, sensors.get(topic, 10)) for topic, kind in self.kinds.items()
        }
        self.node.create_subscription(Twist, "commands/velocity", lambda m: took(log, world, m), 10)
        self.node.create_subscription(
            DiagnosticArray, "/diagnostics", lambda m: log.reasons.append((log.now(), m.status[0].message)), 10
        )
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


def fill(message: Any, plain: Any) -> None:
    """Copies the values of a plain message into ROS's; ROS 1 names the parts of a stamp differently."""
    for name, value in vars(plain).items():
        if not hasattr(message, name):
            name = {"sec": "secs", "nanosec": "nsecs"}[name]
        if hasattr(value, "__dict__"):
            fill(getattr(message, name), value)
        elif isinstance(value, np.ndarray):
            setattr(message, name, value.tolist())
        elif name == "data" and hasattr(message, "_data"):
            message._data = array("B", value)  # rclpy checks every byte of anything else
        else:
            setattr(message, name, value)


def large(depth: Any) -> Any:
    """The depth image at 640 x 480."""
    small = np.frombuffer(depth.data, "<u2").reshape(30, 40)
    big = np.kron(small, np.ones((DEPTH_SCALE, DEPTH_SCALE), np.uint16)).astype("<u2")
    depth.width, depth.height, depth.step, depth.data = 640, 480, 1280, big.tobytes()
    return depth


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("version", choices=("ros1", "ros2"))
    parser.add_argument("--pid", type=int, required=True)
    parser.add_argument("--out", required=True)
    parser.add_argument("--script", required=True)
    args = parser.parse_args()
    log, world = Log(), FaultWorld(np.random.default_rng(0))
    ros = (Ros1 if args.version == "ros1" else Ros2)(log, world)
    world.now_s, world.clock_offset_s = time.monotonic(), ros.clock_s() - time.monotonic()
    deadline = time.monotonic() + 45
    while not ros.ready():
        os.kill(args.pid, 0)  # raises if the node is gone
        if time.monotonic() > deadline:
            sys.exit("the node did not listen within 45 s")
        ros.spin(0.1)
    ros.spin(0.5)
    goal_frame = "map" if args.version == "ros1" else "odom"
    step = 0
    for phase, seconds in json.loads(args.script):
        log.phases.append((log.now(), phase))
        if phase.startswith("signal-"):
            os.kill(args.pid, getattr(signal, "SIG" + phase.removeprefix("signal-")))
        if phase == "drive" and step == 0:
            goal = world.goal()
            goal.header.frame_id = goal_frame
            for _ in range(5):  # odometry first: the goal may be looked at without it, but the robot stands
                ros.publish("odom", world.odom())
                ros.send_transforms()
                ros.spin(0.02)
            ros.publish("goal_pose", goal)
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            step += 1
            begin = time.monotonic()
            world.drive(None, begin - world.now_s)
            if step % 2 == 0 and phase != "no-scan":
                ros.publish("scan", world.scan())
            if step % 2 == 0 and phase != "no-depth":
                ros.publish("depth/image", large(world.depth()))
            if phase != "no-odom":
                ros.publish("odom", world.odom())
            if phase != "no-tf":
                ros.send_transforms()
            ros.spin(max(0.0, 0.05 - (time.monotonic() - begin)))
    with open(args.out, "w") as file:
        json.dump({"commands": log.commands, "reasons": log.reasons, "phases": log.phases, "end": log.now()}, file)


if __name__ == "__main__":
    main()
