"""The ROS 2 node: topics in and out of `RobotRuntime`, and nothing else. Needs rclpy from the robot's distribution.

A lifecycle node: unconfigured, it has loaded nothing; inactive, it senses but sends nothing; active, it drives. Without
a manager it brings itself up (`autostart`). On SIGINT, SIGTERM and deactivation it sends zero and waits until that is
received: once ROS is shut down nothing can be sent any more, and the last command would stay.
"""

# pyright: reportMissingImports=false

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point, PoseStamped, Twist, TwistStamped
from nav_msgs.msg import Odometry
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import CameraInfo, Image, LaserScan
from visualization_msgs.msg import Marker, MarkerArray

from densecavoid.robot.bags import Recorder
from densecavoid.robot.config import load_settings
from densecavoid.robot.folder import FolderPilot
from densecavoid.robot.node_config import NodeConfig
from densecavoid.robot.ros2_action import NavigateToPoseServer
from densecavoid.robot.runtime import RobotRuntime, Step
from densecavoid.robot.wire import MessageTypes, Outgoing

try:
    from tf2_msgs.msg import TFMessage
except ModuleNotFoundError:  # not among the wheels
    TFMessage = None
try:
    from nav2_msgs.action import NavigateToPose
except ModuleNotFoundError:  # a robot without Nav2
    NavigateToPose = None

_ZEROS = 3
_ACKNOWLEDGED_S = 0.5
_RESULT_S = 0.2
"""How long the end waits for the action's result to go out."""
_REPORT_HZ = 5.0
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
    level_of=lambda level: bytes([level]),
)
_LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class DenseCAvoidNode(LifecycleNode):
    """Owns the subscriptions, the timers and the publishers."""

    def __init__(self, config: NodeConfig) -> None:
        super().__init__("densecavoid")
        self._config = config
        self._runtime: RobotRuntime | None = None
        self._active = False
        self._recorder = Recorder(config.record) if config.record is not None else None
        self._reported_s = 0.0
        self._things: list[tuple[Callable[[Any], object], Any]] = []
        for name, value in (("folder", str(config.folder)), ("robot", config.robot)):
            self.declare_parameter(name, value)
        self.declare_parameter("enable_stamped_cmd_vel", False)
        # As long as the node lives: results of what deactivation aborted are asked for after it.
        self._navigation: NavigateToPoseServer | None = None
        if NavigateToPose is not None:
            self._navigation = NavigateToPoseServer(
                self, NavigateToPose, lambda: self._runtime if self._active else None
            )

    # -- lifecycle -----------------------------------------------------------------------------------------------------

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Loads the folder, warms it up, and listens."""
        try:
            settings = load_settings(self.get_parameter("robot").value)
            pilot = FolderPilot(Path(self.get_parameter("folder").value), settings.robot)
        except (ValueError, OSError) as error:
            self.get_logger().error(str(error))
            return TransitionCallbackReturn.FAILURE
        self._runtime = RobotRuntime(pilot, settings, threaded=True)
        self.get_logger().info("loading and warming up")
        self._runtime.warm_up()
        self._runtime.filter.active = False
        stamped = settings.enable_stamped_cmd_vel or self.get_parameter("enable_stamped_cmd_vel").value
        self._outgoing = Outgoing(_TYPES, stamped, self._stamp)
        self._make_publishers()
        self._subscribe(settings.use_tf)
        # By the wall: a simulated clock that stops must not stop the timer that stops the robot.
        timer = self.create_timer(1.0 / settings.control_hz, self._tick, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._things.append((self.destroy_timer, timer))
        self.get_logger().info(f"ready: {pilot.name}, {settings.base_frame} in {settings.odom_frame}")
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Drives from now on, if there is a goal."""
        self._active = True
        if self._runtime is not None:
            self._runtime.filter.active = True
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stands, and sends nothing more; a goal of the action is aborted."""
        self.stop_robot()
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forgets what it has loaded."""
        for destroy, thing in self._things:
            destroy(thing)
        self._things.clear()
        if self._runtime is not None:
            self._runtime.close()
        self._runtime = None
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stands; then as `on_cleanup`."""
        self.stop_robot()
        return self.on_cleanup(state)

    def destroy_node(self) -> None:
        """The action first: it is no part of what a node destroys."""
        if self._navigation is not None:
            self._navigation.destroy()
            self._navigation = None
        super().destroy_node()

    def end_recording(self) -> None:
        """Writes the recording's index, without which it cannot be played."""
        if self._recorder is not None:
            self._recorder.__exit__()

    def stop_robot(self) -> None:
        """Three zeros, waits until they are received, and sends no more; whoever waits for the action is told."""
        if self._runtime is None or not self._active:
            return
        for _ in range(_ZEROS):
            self._publish_velocity(0.0, 0.0)
            time.sleep(0.01)
        self._active = self._runtime.filter.active = False
        self._velocity.wait_for_all_acked(Duration(seconds=_ACKNOWLEDGED_S))
        if self._navigation is not None:
            self._navigation.abort("the node was stopped")

    # -- in ------------------------------------------------------------------------------------------------------------

    def _subscribe(self, use_tf: bool) -> None:
        runtime = self._runtime
        assert runtime is not None

        def listen(kind: Any, topic: str, callback: Callable[[Any], object], qos: Any) -> None:
            subscription = self.create_subscription(kind, topic, callback, qos)
            self._things.append((self.destroy_subscription, subscription))

        now, ros_now = time.monotonic, self._ros_now_s
        # The newest alone: on a busy computer a queue of old ones would keep everything late.
        sensors, newest = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT), QoSProfile(depth=1)
        listen(LaserScan, "scan", self._on_scan, sensors)
        listen(Image, "depth/image", lambda m: runtime.on_depth(m, now(), ros_now()), sensors)
        listen(CameraInfo, "depth/camera_info", runtime.on_camera_info, sensors)
        listen(Odometry, "odom", lambda m: runtime.on_odom(m, now(), ros_now()), newest)
        listen(PoseStamped, "goal_pose", self._on_goal, newest)
        listen(PoseStamped, "move_base_simple/goal", self._on_goal, newest)
        if use_tf and TFMessage is not None:
            many = QoSProfile(depth=100)
            latched = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
            listen(TFMessage, "/tf", lambda m: runtime.on_transforms(m.transforms, now(), False), many)
            listen(TFMessage, "/tf_static", lambda m: runtime.on_transforms(m.transforms, now(), True), latched)
        elif use_tf:
            self.get_logger().warning("tf2_msgs is missing: only goals in the odometry's and the robot's own frame")

    def _on_scan(self, message: LaserScan) -> None:
        assert self._runtime is not None
        self._runtime.on_scan(message, time.monotonic(), self._ros_now_s())
        if self._recorder is not None:
            self._recorder.scan(self._ros_now_s(), message)

    def _on_goal(self, message: PoseStamped) -> None:
        assert self._runtime is not None
        refused = self._runtime.on_goal(message, time.monotonic())
        if refused:
            self.get_logger().error(f"goal refused: {refused}")

    def _ros_now_s(self) -> float:
        return self.get_clock().now().nanoseconds * 1e-9

    # -- out -----------------------------------------------------------------------------------------------------------

    def _make_publishers(self) -> None:
        def publisher(kind: Any, topic: str, qos: Any = 10) -> Any:
            made = self.create_publisher(kind, topic, qos)
            self._things.append((self.destroy_publisher, made))
            return made

        self._velocity = publisher(self._outgoing.velocity_type, "cmd_vel")
        self._people = publisher(MarkerArray, "~/people")
        self._diagnostics = publisher(DiagnosticArray, "/diagnostics")
        self._prediction = publisher(Image, "~/prediction", _LATCHED)

    def _tick(self) -> None:
        runtime = self._runtime
        assert runtime is not None
        now_s = time.monotonic()
        step = runtime.step(now_s, self._ros_now_s())
        if self._active and step.command.publish:
            self._publish_velocity(step.command.linear_velocity, step.command.angular_velocity)
        if self._navigation is not None:
            self._navigation.update(step, now_s)
        if self._recorder is not None:
            self._recorder.step(self._ros_now_s(), step, runtime.settings.base_frame)
        if now_s - self._reported_s >= 1.0 / _REPORT_HZ:
            self._reported_s = now_s
            self._publish_report(step, now_s)

    def _publish_velocity(self, linear: float, angular: float) -> None:
        self._velocity.publish(self._outgoing.velocity(linear, angular))

    def _stamp(self, header: Any) -> None:
        assert self._runtime is not None
        header.stamp = self.get_clock().now().to_msg()
        header.frame_id = self._runtime.settings.base_frame

    def _publish_report(self, step: Step, now_s: float) -> None:
        assert self._runtime is not None
        self._diagnostics.publish(self._outgoing.diagnostics(self._runtime, step, now_s))
        self._people.publish(self._outgoing.people(step.people))
        image = self._runtime.pilot.prediction()
        if image is not None:
            self._prediction.publish(self._outgoing.image(image))


def run(config: NodeConfig, ros_args: Sequence[str]) -> None:
    """Until SIGINT or SIGTERM; zero is sent and received before ROS is shut down."""
    stop = False

    def on_signal(number: int, frame: object) -> None:
        nonlocal stop
        stop = True

    signal.signal(signal.SIGINT, on_signal)
    signal.signal(signal.SIGTERM, on_signal)
    rclpy.init(args=[sys.argv[0], *ros_args], signal_handler_options=SignalHandlerOptions.NO)
    node = DenseCAvoidNode(config)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        if config.autostart:
            if node.trigger_configure() != TransitionCallbackReturn.SUCCESS:
                raise ValueError("the node could not be configured (the log says why)")
            node.trigger_activate()
        while not stop:
            executor.spin_once(timeout_sec=0.05)
        node.stop_robot()
        end_s = time.monotonic() + _RESULT_S
        while NavigateToPose is not None and time.monotonic() < end_s:
            executor.spin_once(timeout_sec=0.02)
    finally:
        node.stop_robot()
        node.end_recording()
        executor.shutdown()
        node.destroy_node()
        rclpy.shutdown()
