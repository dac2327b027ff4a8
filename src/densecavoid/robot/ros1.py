"""The ROS 1 node: topics in and out of `RobotRuntime`, and nothing else. Needs rospy of the robot's distribution, or
Debian's (python3-rospy).

It publishes to the mux (`cmd_vel_mux/input/navi` on a Turtlebot 2: remap `cmd_vel`), and zero on SIGINT, SIGTERM and
shutdown.
"""

# pyright: reportMissingImports=false

from __future__ import annotations

import signal
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point, PoseStamped, Twist, TwistStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import CameraInfo, Image, LaserScan
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import Marker, MarkerArray

from densecavoid.robot.bags import Recorder
from densecavoid.robot.config import load_settings
from densecavoid.robot.folder import FolderPilot
from densecavoid.robot.node_config import NodeConfig
from densecavoid.robot.runtime import RobotRuntime, Step
from densecavoid.robot.wire import MessageTypes, Outgoing

_ZEROS = 3
_REPORT_S = 0.2
_TYPES = MessageTypes(
    twist=Twist,
    twist_stamped=TwistStamped,
    diagnostic_array=DiagnosticArray,
    diagnostic_status=DiagnosticStatus,
    key_value=KeyValue,
    image=Image,
    marker=Marker,
    marker_array=MarkerArray,
    point=Point,
    level_of=int,
)


class DenseCAvoidNode:
    """Owns the subscribers, the publishers and the loop's thread."""

    def __init__(self, config: NodeConfig) -> None:
        """
        Raises:
            ValueError, OSError: if folder or settings are wrong.
        """
        self.settings = load_settings(rospy.get_param("~robot", config.robot))
        pilot = FolderPilot(Path(rospy.get_param("~folder", str(config.folder))), self.settings.robot)
        self._runtime = RobotRuntime(pilot, self.settings, threaded=True)
        rospy.loginfo("loading and warming up")
        self._runtime.warm_up()
        # rospy calls back from a thread for each topic; the runtime is for one at a time.
        self._lock = threading.Lock()
        stamped = self.settings.enable_stamped_cmd_vel or rospy.get_param("~enable_stamped_cmd_vel", False)
        self._outgoing = Outgoing(_TYPES, stamped, self._stamp)
        self._velocity = rospy.Publisher("cmd_vel", self._outgoing.velocity_type, queue_size=1)
        self._people = rospy.Publisher("~people", MarkerArray, queue_size=1)
        self._prediction = rospy.Publisher("~prediction", Image, queue_size=1, latch=True)
        self._diagnostics = rospy.Publisher("/diagnostics", DiagnosticArray, queue_size=10)
        self._reported_s = 0.0
        self._stopped = False
        self._recorder = Recorder(config.record) if config.record is not None else None
        rospy.on_shutdown(self.stop_robot)
        self._subscribe()
        rospy.loginfo(
            "ready: %s, %s in %s", self._runtime.pilot.name, self.settings.base_frame, self.settings.odom_frame
        )

    def _subscribe(self) -> None:
        runtime, lock = self._runtime, self._lock

        def listen(kind: Any, topic: str, callback: Any, queue_size: int = 1) -> None:
            def locked(message: Any) -> None:
                with lock:
                    callback(message)

            # The buffer must take a whole image, or old ones pile up in it.
            rospy.Subscriber(topic, kind, locked, queue_size=queue_size, buff_size=1 << 24, tcp_nodelay=True)

        now = time.monotonic
        listen(LaserScan, "scan", self._on_scan)
        listen(Image, "depth/image", lambda m: runtime.on_depth(m, now(), _ros_now_s()))
        listen(CameraInfo, "depth/camera_info", runtime.on_camera_info)
        listen(Odometry, "odom", lambda m: runtime.on_odom(m, now(), _ros_now_s()))
        listen(PoseStamped, "goal_pose", self._on_goal)
        listen(PoseStamped, "move_base_simple/goal", self._on_goal)
        if self.settings.use_tf:
            listen(TFMessage, "/tf", lambda m: runtime.on_transforms(m.transforms, now(), False), 100)
            listen(TFMessage, "/tf_static", lambda m: runtime.on_transforms(m.transforms, now(), True), 100)

    def _on_scan(self, message: LaserScan) -> None:
        self._runtime.on_scan(message, time.monotonic(), _ros_now_s())
        if self._recorder is not None and not self._stopped:
            self._recorder.scan(_ros_now_s(), message)

    def _on_goal(self, message: PoseStamped) -> None:
        refused = self._runtime.on_goal(message, time.monotonic())
        if refused:
            rospy.logerr("goal refused: %s", refused)

    def spin(self, wanted: Callable[[], bool]) -> None:
        """The control loop, by the wall's clock, for as long as it is wanted and the master lives."""
        period_s = 1.0 / self.settings.control_hz
        due_s = time.monotonic()
        while wanted() and not rospy.is_shutdown():
            with self._lock:
                self._tick()
            due_s = max(due_s + period_s, time.monotonic())
            time.sleep(max(0.0, due_s - time.monotonic()))

    def _tick(self) -> None:
        now_s = time.monotonic()
        step = self._runtime.step(now_s, _ros_now_s())
        if step.command.publish and not self._stopped:
            self._publish_velocity(step.command.linear_velocity, step.command.angular_velocity)
        if self._recorder is not None and not self._stopped:
            self._recorder.step(_ros_now_s(), step, self.settings.base_frame)
        if now_s - self._reported_s >= _REPORT_S:
            self._reported_s = now_s
            self._publish_report(step, now_s)

    def stop_robot(self) -> None:
        """Three zeros; nothing but zero after them. Not to be called from a signal handler, which may interrupt whoever
        holds the lock."""
        with self._lock:
            if self._stopped:
                return
            self._stopped = True
            for _ in range(_ZEROS):
                self._publish_velocity(0.0, 0.0)
                time.sleep(0.01)
            if self._recorder is not None:
                self._recorder.__exit__()

    def _publish_velocity(self, linear: float, angular: float) -> None:
        self._velocity.publish(self._outgoing.velocity(linear, angular))

    def _stamp(self, header: Any) -> None:
        header.stamp, header.frame_id = rospy.Time.now(), self.settings.base_frame

    def _publish_report(self, step: Step, now_s: float) -> None:
        self._diagnostics.publish(self._outgoing.diagnostics(self._runtime, step, now_s))
        self._people.publish(self._outgoing.people(step.people))
        image = self._runtime.pilot.prediction()
        if image is not None:
            self._prediction.publish(self._outgoing.image(image))


def _ros_now_s() -> float:
    return rospy.get_time()


def run(config: NodeConfig, ros_args: Sequence[str]) -> None:
    """Until SIGINT, SIGTERM or a shutdown by the master; zero is sent before ROS is shut down."""
    stop = False

    def on_signal(number: int, frame: object) -> None:
        nonlocal stop
        stop = True

    signal.signal(signal.SIGINT, on_signal)
    signal.signal(signal.SIGTERM, on_signal)
    # rospy's own handlers would run the shutdown hook in the middle of a control step, which holds the lock.
    rospy.init_node("densecavoid", argv=[sys.argv[0], *ros_args], disable_signals=True)
    node = DenseCAvoidNode(config)
    try:
        node.spin(lambda: not stop)
    finally:
        node.stop_robot()
        rospy.signal_shutdown("stopped")
