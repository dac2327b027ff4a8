"""How a robot on two wheels follows a velocity that may point anywhere. Knows no obstacles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from densecavoid.frames import Command, RobotConfig, require


@dataclass(frozen=True)
class TurningConfig:
    """How a wished velocity becomes a command."""

    turn_time_s: float = 0.5
    """In which the heading is to reach the wished direction."""
    still_m_s: float = 0.05
    """A slower wish has no direction: the robot turns towards where it wants to go in the end."""

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            require(getattr(self, name) > 0, f"TurningConfig.{name}", getattr(self, name), "positive")


def follow_velocity(
    wish_r: Float[np.ndarray, "B 2"],
    fallback_rad: Float[np.ndarray, "B"],
    robot: RobotConfig,
    config: TurningConfig = TurningConfig(),
) -> Command:
    """The command that makes good a wished velocity.

    The turn takes `turn_time_s`, or as long as the robot needs; meanwhile it drives so fast that the end of its arc is
    as near as can be to where the wish would have led: v = |wish| a sin a / (2 (1 - cos a)) for a turn by a
    (Alonso-Mora et al., Optimal Reciprocal Collision Avoidance for Multiple Non-Holonomic Robots, DARS 2010, eq. 9).
    A turn that takes longer than that is made on the spot, up to what can be turned in the time.

    Args:
        wish_r: m/s in the robot's frame.
        fallback_rad: Bearing to turn to where the wish is next to nothing.
        robot: Its limits are kept.
        config: see there.
    """
    speed = np.hypot(wish_r[:, 0], wish_r[:, 1])
    moving = speed > config.still_m_s
    angle = np.where(moving, np.arctan2(wish_r[:, 1], wish_r[:, 0]), fallback_rad)
    angular = np.clip(angle / config.turn_time_s, -robot.max_angular_velocity, robot.max_angular_velocity)
    small = np.abs(angle) < 1e-4
    a = np.where(small, 1e-4, angle)
    best = a * np.sin(a) / (2.0 * (1.0 - np.cos(a)))
    linear = np.where(moving, speed * np.maximum(best, 0.0), 0.0)
    # What is left of the turn after this control step points elsewhere: not faster than the wish along the heading.
    linear = np.minimum(linear, speed * np.maximum(np.cos(angle), 0.0))
    linear = np.clip(linear, 0.0, robot.max_linear_velocity)
    return Command(linear.astype(np.float32), angular.astype(np.float32))
