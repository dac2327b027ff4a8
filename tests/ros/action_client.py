"""A robot behind real topics and a client of the action NavigateToPose: sends goals, cancels, drops TF, deactivates the
node, and writes down what came back. A process of its own, as body.py; needs what ros2_messages.py builds.

python action_client.py ros2 --pid NODE --out FILE --script '[["success", 20], ["signal-interrupted", 5]]'

Each name is a method of `Scenes` with the seconds that it may take.
"""

# pyright: reportMissingImports=false

from __future__ import annotations

import argparse
import json
import math
import os
import signal
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from body import LargeImages, Log, Ros2, fill, wait_for_node
from geometry_msgs.msg import TransformStamped
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from nav2_msgs.action import NavigateToPose
from rclpy.action import ActionClient
from rclpy.qos import DurabilityPolicy, QoSProfile
from tf2_msgs.msg import TFMessage

MOUNT_YAW_RAD = 1.0
"""Of the scanner: whoever takes it for nought is blind to the left."""
ODOM_IN_MAP = (5.0, 1.0, math.pi / 2)
"""x, y (m) and heading (rad): odometry's ahead is the map's left."""


class Turned(LargeImages):
    """The fault world with a scanner that is mounted askew and says so by TF alone."""

    stuck = False
    """Whether the wheels turn for nothing."""

    def drive(self, command: tuple[float, float] | None, dt: float) -> None:
        pose = self.pose
        super().drive(command, dt)
        if self.stuck:
            self.pose, self.velocity = pose, (0.0, 0.0)

    def scan(self) -> Any:
        scan = super().scan()
        scan.angle_min -= MOUNT_YAW_RAD
        return scan


class Goal:
    """One goal, and what the server said of it."""

    def __init__(self, client: ActionClient, x: float, y: float, frame: str) -> None:
        self.feedback: list[tuple[float, float, int, str]] = []
        self.handle: Any = None
        self.result: Any = None
        self.answered = False
        goal = NavigateToPose.Goal()
        goal.pose.header.frame_id = frame
        goal.pose.pose.position.x, goal.pose.pose.position.y = x, y
        client.send_goal_async(goal, self._on_feedback).add_done_callback(self._on_answer)

    def _on_feedback(self, message: Any) -> None:
        told = message.feedback
        seconds = told.navigation_time.sec + 1e-9 * told.navigation_time.nanosec
        frame = told.current_pose.header.frame_id
        self.feedback.append((told.distance_remaining, seconds, told.number_of_recoveries, frame))

    def _on_answer(self, future: Any) -> None:
        self.handle, self.answered = future.result(), True
        if self.handle.accepted:
            self.handle.get_result_async().add_done_callback(self._on_result)

    def _on_result(self, future: Any) -> None:
        self.result = future.result()

    def told(self) -> dict[str, Any]:
        """As plain values; status by action_msgs/GoalStatus: 4 succeeded, 5 cancelled, 6 aborted."""
        result = self.result
        return {
            "accepted": self.handle is not None and self.handle.accepted,
            "status": result and result.status,
            "code": result and result.result.error_code,
            "error": result and result.result.error_msg,
            "feedback": self.feedback,
        }


class Scenes:
    """The robot and the client; a scene returns what the tests look at."""

    def __init__(self, pid: int, log: Log) -> None:
        self.pid, self.log, self.world = pid, log, Turned(np.random.default_rng(0))
        self.ros = Ros2(log, self.world)
        node = self.ros.node
        self.client = ActionClient(node, NavigateToPose, "navigate_to_pose")
        self.lifecycle = node.create_client(ChangeState, "/densecavoid/change_state")
        self.tf = node.create_publisher(TFMessage, "/tf", 100)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.tf_static = node.create_publisher(TFMessage, "/tf_static", latched)
        self.with_tf = True
        self.steps = 0
        self.world.now_s = time.monotonic()
        self.world.clock_offset_s = self.ros.clock_s() - time.monotonic()

    def wait_for_node(self) -> None:
        wait_for_node(
            self.pid,
            self.ros,
            lambda: self.ros.ready() and self.client.server_is_ready() and self.tf.get_subscription_count() > 0,
        )

    def run(self, limit_s: float, until: Callable[[], bool] = lambda: False) -> float:
        """The robot goes on until something is so; returns the seconds that it took."""
        start = time.monotonic()
        while time.monotonic() - start < limit_s and not until():
            self.steps += 1
            begin = time.monotonic()
            self.world.drive(None, begin - self.world.now_s)
            self.ros.publish("odom", self.world.odom())
            if self.with_tf:
                self.send(self.tf, "map", "odom", ODOM_IN_MAP)
            if self.steps % 2 == 0:
                self.ros.publish("scan", self.world.scan())
                self.ros.publish("depth/camera_info", self.world.camera_info())
                self.ros.publish("depth/image", self.world.depth())
            self.ros.spin(max(0.0, 0.05 - (time.monotonic() - begin)))
        return time.monotonic() - start

    def send(self, publisher: Any, parent: str, child: str, pose: tuple[float, float, float]) -> None:
        transform = TransformStamped()
        fill(transform, self.world.transforms(parent, child)[0])
        transform.transform.translation.x, transform.transform.translation.y, yaw = pose
        transform.transform.rotation.z, transform.transform.rotation.w = math.sin(yaw / 2), math.cos(yaw / 2)
        publisher.publish(TFMessage(transforms=[transform]))

    def goal(self, ahead: float, frame: str = "map") -> Goal:
        """A goal so far ahead (m) of where odometry began, in its own frame or in the map's."""
        x, y, yaw = ODOM_IN_MAP
        place = (x + ahead * math.cos(yaw), y + ahead * math.sin(yaw)) if frame == "map" else (ahead, 0.0)
        goal = Goal(self.client, *place, frame)
        self.run(5.0, lambda: goal.answered)
        return goal

    def drives(self) -> bool:
        return bool(self.log.commands) and self.log.commands[-1][1] > 0.1

    def drive_for_a_second(self, limit_s: float) -> bool:
        """Whether it drove within the limit; a moment later it may stand, as sensors come late on a busy computer."""
        self.run(limit_s, self.drives)
        driven = self.drives()
        self.run(1.0)
        return driven

    # -- scenes --------------------------------------------------------------------------------------------------------

    def extrinsics(self, limit_s: float) -> dict[str, Any]:
        """Without the scanner's place, and then with it."""
        self.run(1.5)
        before = [reason for _, reason in self.log.reasons]
        # Once, as drivers do.
        self.send(self.tf_static, "base_footprint", "laser", (0.0, 0.0, MOUNT_YAW_RAD))
        self.run(limit_s, lambda: bool(self.log.reasons) and self.log.reasons[-1][1] == "no goal yet")
        return {"before": before, "after": self.log.reasons[-1][1]}

    def rejected(self, limit_s: float) -> dict[str, Any]:
        return self.goal(math.nan, "odom").told()

    def success(self, limit_s: float) -> dict[str, Any]:
        goal = self.goal(2.5)
        self.run(limit_s, lambda: goal.result is not None)
        where = list(map(float, self.world.pose))
        self.run(1.0)
        return goal.told() | {"where": where, "last": self.log.commands[-1][1:]}

    def cancel(self, limit_s: float) -> dict[str, Any]:
        goal = self.goal(1000.0, "odom")
        driven, asked = self.drive_for_a_second(limit_s), self.log.now()
        goal.handle.cancel_goal_async()
        self.run(3.0, lambda: goal.result is not None)
        answered = self.log.now() - asked
        self.run(1.5)
        return goal.told() | {"driven": driven, "answered_s": answered, "moving_s": self.moving_after(asked)}

    def preempt(self, limit_s: float) -> dict[str, Any]:
        """By a goal of the action, and that one by a goal on a topic."""
        first = self.goal(1000.0, "odom")
        self.run(limit_s, self.drives)
        second = self.goal(900.0, "odom")
        self.run(3.0, lambda: first.result is not None)
        driven = self.drive_for_a_second(limit_s)
        early = second.told()
        plain = self.world.goal()
        plain.header.frame_id = "odom"
        self.ros.publish("goal_pose", plain)
        self.run(3.0, lambda: second.result is not None)
        self.run(0.3)
        going_on, replaced = self.drive_for_a_second(limit_s), second.told()
        third = self.goal(800.0, "odom")
        self.run(0.5)
        third.handle.cancel_goal_async()
        self.run(3.0, lambda: third.result is not None)
        goals = {"first": first.told(), "early": early, "second": replaced, "third": third.told()}
        return goals | {"driven": driven, "going_on": going_on}

    def unknown_frame(self, limit_s: float) -> dict[str, Any]:
        self.run(1.0)
        sent = self.log.now()
        goal = self.goal(1.0, "moon")
        seconds = self.run(limit_s, lambda: goal.result is not None)
        return goal.told() | {"seconds": seconds, "moving_s": self.moving_after(sent)}

    def lost(self, limit_s: float) -> dict[str, Any]:
        """TF stops for a moment, and then for good."""
        goal = self.goal(1000.0)
        self.run(5.0, self.drives)
        self.with_tf = False
        self.run(1.3)
        paused, stood = goal.result is None, not self.drives()
        self.with_tf = True
        self.run(5.0, self.drives)
        resumed = self.drives()
        self.with_tf, gone = False, self.log.now()
        self.run(limit_s, lambda: goal.result is not None)
        self.with_tf = True
        self.run(1.0)
        moving = self.moving_after(gone)
        return goal.told() | {"paused": paused and stood, "resumed": resumed, "moving_s": moving}

    def stuck(self, limit_s: float) -> dict[str, Any]:
        """It faces the wall and cannot move: it tries to turn towards the free way."""
        self.world.pose, self.world.stuck = np.array([0.0, 0.0, 1.2]), True
        goal = self.goal(1000.0, "odom")

        def escapes() -> bool:
            # Feedback and diagnostics come at different times.
            said = any(reason.startswith("frozen") for _, reason in self.log.reasons)
            return said and any(recoveries for _, _, recoveries, _ in goal.feedback)

        self.run(limit_s, escapes)
        self.world.pose, self.world.stuck = np.zeros(3), False
        goal.handle.cancel_goal_async()
        self.run(3.0, lambda: goal.result is not None)
        return goal.told()

    def deactivated(self, limit_s: float) -> dict[str, Any]:
        goal = self.goal(1000.0, "odom")
        driven, asked = self.drive_for_a_second(limit_s), self.log.now()
        self.change(Transition.TRANSITION_DEACTIVATE)
        self.run(limit_s, lambda: goal.result is not None)
        self.run(1.0)
        moving = self.moving_after(asked)
        refused = self.goal(1000.0, "odom").told()
        self.change(Transition.TRANSITION_ACTIVATE)
        again = self.log.now()
        self.run(1.5)
        return goal.told() | {
            "driven": driven,
            "moving_s": moving,
            "inactive": refused,
            "moving_again_s": self.moving_after(again),
        }

    def interrupted(self, limit_s: float) -> dict[str, Any]:
        """SIGINT, with a goal on its way."""
        goal = self.goal(1000.0, "odom")
        driven, asked = self.drive_for_a_second(limit_s), self.log.now()
        os.kill(self.pid, signal.SIGINT)
        self.run(limit_s, lambda: goal.result is not None)
        self.run(1.0)
        told = {"driven": driven, "moving_s": self.moving_after(asked), "last": self.log.commands[-1][1:]}
        return goal.told() | told

    def change(self, transition: int) -> None:
        request = ChangeState.Request()
        request.transition.id = transition
        future = self.lifecycle.call_async(request)
        self.run(5.0, future.done)
        assert future.done() and future.result().success

    def moving_after(self, since_s: float) -> float:
        """Seconds after a time until the last command that was not zero; 0 if all were."""
        moving = [at - since_s for at, *command in self.log.commands if at >= since_s and any(command)]
        return max(moving, default=0.0)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("version", choices=("ros2",))
    parser.add_argument("--pid", type=int, required=True)
    parser.add_argument("--out", required=True)
    parser.add_argument("--script", required=True)
    args = parser.parse_args()
    log = Log()
    scenes = Scenes(args.pid, log)
    scenes.wait_for_node()
    told: dict[str, Any] = {}
    for name, limit_s in json.loads(args.script):
        begin, scene = log.now(), name.removeprefix("signal-")
        told[scene] = getattr(scenes, scene)(limit_s)
        told[scene]["took_s"] = log.now() - begin
    told["commands"], told["reasons"] = log.commands, log.reasons
    with open(args.out, "w") as file:
        json.dump(told, file)


if __name__ == "__main__":
    main()
