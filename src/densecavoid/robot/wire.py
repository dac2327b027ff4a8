"""What both nodes publish: velocity, markers, the prediction image, diagnostics. Message types are handed in: those of
ROS 1 and ROS 2 differ only in where they come from. No ROS is imported.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from densecavoid.robot.runtime import RobotRuntime, Step
from densecavoid.safety import PeopleNear

HORIZON_S = 0.8
"""How far ahead the predicted places of people are shown."""
_BODY_HEIGHT_M = 1.7
_PERSON_RGBA, _FUTURE_RGBA = (0.1, 0.5, 0.9, 0.8), (0.9, 0.4, 0.1, 0.9)


@dataclass(frozen=True)
class MessageTypes:
    """The classes of one ROS version."""

    twist: Any
    twist_stamped: Any
    diagnostic_array: Any
    diagnostic_status: Any
    key_value: Any
    image: Any
    marker: Any
    marker_array: Any
    point: Any
    level_of: Callable[[int], Any]
    """How a diagnostic level is written: a byte in ROS 2."""


class Outgoing:
    """Makes messages of one ROS version."""

    def __init__(self, types: MessageTypes, stamped: bool, stamp: Callable[[Any], None]) -> None:
        """
        Args:
            types: message classes.
            stamped: TwistStamped instead of Twist.
            stamp: writes time and frame into a header.
        """
        self._types, self._stamped, self._stamp = types, stamped, stamp
        self.velocity_type = types.twist_stamped if stamped else types.twist

    def velocity(self, linear: float, angular: float) -> Any:
        """A velocity (m/s, rad/s)."""
        message = self.velocity_type()
        twist = message.twist if self._stamped else message
        twist.linear.x, twist.angular.z = float(linear), float(angular)
        if self._stamped:
            self._stamp(message.header)
        return message

    def diagnostics(self, runtime: RobotRuntime, step: Step, now_s: float) -> Any:
        """Level, one line that says why, and values by name."""
        distance = "none" if math.isnan(step.goal_distance_m) else f"{step.goal_distance_m:.2f} m"
        values = {
            "action": step.command.action,
            "policy asks for": f"{step.asked[0]:.2f} m/s, {step.asked[1]:.2f} rad/s",
            "wheels get": f"{step.command.linear_velocity:.2f} m/s, {step.command.angular_velocity:.2f} rad/s",
            "goal": "reached" if step.goal_reached else distance,
            "people": str(len(step.people.pos_r)),
            "camera's place": runtime.camera_place,
        }
        types = self._types
        status = types.diagnostic_status(level=types.level_of(step.level), name="densecavoid", message=step.message)
        values |= runtime.watchdog.report(now_s)
        status.values = [types.key_value(key=key, value=value) for key, value in values.items()]
        array = types.diagnostic_array(status=[status])
        self._stamp(array.header)
        return array

    def people(self, people: PeopleNear) -> Any:
        """A cylinder where everybody is, and a line to where they will be."""
        markers = [self._marker("", 0, self._types.marker.DELETEALL, _PERSON_RGBA)]
        for index, (pos, vel, radius) in enumerate(zip(*people, strict=True)):
            body = self._marker("people", index, self._types.marker.ADD, _PERSON_RGBA)
            body.type = self._types.marker.CYLINDER
            body.pose.position.x, body.pose.position.y = float(pos[0]), float(pos[1])
            body.pose.position.z, body.scale.z = _BODY_HEIGHT_M / 2, _BODY_HEIGHT_M
            body.scale.x = body.scale.y = 2.0 * float(radius)
            way = self._marker("predictions", index, self._types.marker.ADD, _FUTURE_RGBA)
            way.type, way.scale.x = self._types.marker.LINE_STRIP, 0.04
            ends = (pos, pos + HORIZON_S * vel)
            way.points = [self._types.point(x=float(x), y=float(y), z=0.1) for x, y in ends]
            markers += [body, way]
        return self._types.marker_array(markers=markers)

    def image(self, image: np.ndarray) -> Any:
        """A grey image."""
        height, width = image.shape
        message = self._types.image(height=height, width=width, encoding="mono8", step=width, data=image.tobytes())
        self._stamp(message.header)
        return message

    def _marker(self, namespace: str, index: int, action: int, rgba: tuple[float, float, float, float]) -> Any:
        marker = self._types.marker(ns=namespace, id=index, action=action)
        self._stamp(marker.header)
        marker.color.r, marker.color.g, marker.color.b, marker.color.a = rgba
        marker.pose.orientation.w = 1.0
        return marker
