"""Nav2's action NavigateToPose around `RobotRuntime`: gives it goals and tells how they end. It neither plans nor
drives: what the wheels get is decided by the runtime alone, and a goal that ends here is taken away from it.

Everything runs in the node's one thread and nothing waits: whoever executes a goal is a coroutine that sleeps until the
control step says how it ended.
"""

# pyright: reportMissingImports=false

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.task import Future

from densecavoid.robot import messages
from densecavoid.robot.runtime import MALFORMED, RobotRuntime, Step

ACTION_NAME = "navigate_to_pose"
LOST_S = 2.0
"""A goal whose frame TF has not known for longer is aborted; until then the robot stands and waits."""
FEEDBACK_HZ = 5.0
_TF_ERROR, _UNKNOWN = 9002, 9000
"""Of nav2_msgs, in the versions whose results have an error code."""
_CANCELLED = "goal cancelled"


@dataclass
class _Current:
    """The goal that is driven to."""

    handle: Any
    runtime: RobotRuntime
    number: int
    """The runtime's, when it took the goal."""
    begun_s: float
    lost_since_s: float | None = None
    told_s: float = -math.inf
    escapes: int = 0
    escaping: bool = False


class NavigateToPoseServer:
    """Owns the action server and the one goal that is driven to. The newest wins, as with goals on topics; one on a
    topic aborts the action's."""

    def __init__(self, node: Any, action_type: Any, driving: Callable[[], RobotRuntime | None]) -> None:
        """
        Args:
            node: the node that offers it.
            action_type: nav2_msgs/action/NavigateToPose.
            driving: the node's runtime; None unless the node is active.
        """
        self._node, self._type, self._driving = node, action_type, driving
        self._current: _Current | None = None
        self._results: dict[bytes, Future] = {}
        self._server = ActionServer(
            node,
            action_type,
            ACTION_NAME,
            self._result,
            goal_callback=self._on_goal,
            handle_accepted_callback=self._on_accepted,
            cancel_callback=self._on_cancel,
        )

    def update(self, step: Step, now_s: float) -> None:
        """Feedback, or the end of the goal.

        Args:
            step: what the control step has just decided.
            now_s: its time, by the steady clock.
        """
        current = self._current
        if current is None:
            return
        if current.handle.is_cancel_requested:
            self._finish("canceled", 0, "")
        elif current.runtime.goal_number != current.number:
            self._finish("abort", _UNKNOWN, "another goal came")
        elif step.goal_reached:
            self._finish("succeed", 0, "")
        else:
            self._go_on(current, step, now_s)

    def abort(self, why: str) -> None:
        """Ends the goal, if there is one; `why` is what the client is told."""
        if self._current is not None:
            self._finish("abort", _UNKNOWN, why)

    def destroy(self) -> None:
        """Ends the action; results that were not fetched are lost."""
        self._server.destroy()

    # -- from clients --------------------------------------------------------------------------------------------------

    def _on_goal(self, request: Any) -> GoalResponse:
        runtime = self._driving()
        if runtime is None:
            return self._reject("the node is not active")
        try:
            messages.goal_from_ros(request.pose)
        except MALFORMED as error:
            # As on a topic: whoever sends a goal does not want the one before any more.
            runtime.end_goal(f"goal refused: {error}")
            return self._reject(str(error))
        return GoalResponse.ACCEPT

    def _reject(self, why: str) -> GoalResponse:
        self._node.get_logger().error(f"goal rejected: {why}")
        return GoalResponse.REJECT

    def _on_accepted(self, handle: Any) -> None:
        """Only now the runtime gets it: a goal of which the client was not told must not move the robot."""
        if self._current is not None:
            self._finish("abort", _UNKNOWN, "another goal came")
        self._results[bytes(handle.goal_id.uuid)] = Future()
        handle.execute()
        runtime, now_s = self._driving(), time.monotonic()
        if runtime is None:
            self._end(handle, "abort", _UNKNOWN, "the node is not active")
            return
        refused = runtime.on_goal(handle.request.pose, now_s)
        if refused:
            self._end(handle, "abort", _UNKNOWN, refused)
            return
        self._current = _Current(handle, runtime, runtime.goal_number, now_s)

    def _on_cancel(self, handle: Any) -> CancelResponse:
        """Takes the goal away at once; the next control step sends zero and says that it is cancelled."""
        if self._current is not None and self._current.handle == handle:
            self._current.runtime.end_goal(_CANCELLED)
        return CancelResponse.ACCEPT

    async def _result(self, handle: Any) -> Any:
        key = bytes(handle.goal_id.uuid)
        try:
            return await self._results[key]
        finally:
            del self._results[key]

    # -- to clients ----------------------------------------------------------------------------------------------------

    def _go_on(self, current: _Current, step: Step, now_s: float) -> None:
        escaping = step.command.action == "escape"
        current.escapes += escaping and not current.escaping
        current.escaping = escaping
        lost = current.runtime.watchdog.goal_fault
        if not lost:
            current.lost_since_s = None
        elif current.lost_since_s is None:
            current.lost_since_s = now_s
        elif now_s - current.lost_since_s > LOST_S:
            self._finish("abort", _TF_ERROR, lost)
            return
        # No feedback as long as nobody knows how far it is.
        if now_s - current.told_s >= 1.0 / FEEDBACK_HZ and math.isfinite(step.goal_distance_m):
            current.told_s = now_s
            current.handle.publish_feedback(self._feedback(current, step, now_s))

    def _feedback(self, current: _Current, step: Step, now_s: float) -> Any:
        feedback = self._type.Feedback()
        feedback.distance_remaining = step.goal_distance_m
        feedback.number_of_recoveries = min(current.escapes, 32767)
        seconds = now_s - current.begun_s
        feedback.navigation_time.sec = int(seconds)
        feedback.navigation_time.nanosec = int(1e9 * (seconds % 1.0))
        pose = current.runtime.pose_odom
        if pose is not None:
            where = feedback.current_pose
            where.header.stamp = self._node.get_clock().now().to_msg()
            where.header.frame_id = current.runtime.settings.odom_frame
            where.pose.position.x, where.pose.position.y = pose[:2]
            where.pose.orientation.z, where.pose.orientation.w = math.sin(pose[2] / 2), math.cos(pose[2] / 2)
        return feedback

    def _finish(self, how: str, code: int, why: str) -> None:
        """Ends the goal that is driven to, and takes it from the runtime unless that has another by now."""
        current, self._current = self._current, None
        assert current is not None
        if how != "succeed" and current.runtime.goal_number == current.number:
            current.runtime.end_goal(why or _CANCELLED)
        self._end(current.handle, how, code, why)

    def _end(self, handle: Any, how: str, code: int, why: str) -> None:
        """`how` is the handle's method: succeed, abort or canceled."""
        if why:
            self._node.get_logger().warning(f"goal aborted: {why}")
        getattr(handle, how)()
        result = self._type.Result()
        if hasattr(result, "error_code"):
            result.error_code = code
        if hasattr(result, "error_msg"):
            result.error_msg = why
        self._results[bytes(handle.goal_id.uuid)].set_result(result)
