"""The least a navigator can do: turn towards the goal, drive there, and stop before what is in the way.

It sees odometry and the front of the scan, and avoids nothing: what stands in its way stops it for good.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from densecavoid.frames import Command, LidarConfig, RobotConfig, SensorFrame, goal_polar, require


@dataclass(frozen=True)
class GoToGoalConfig:
    """How eagerly it turns, slows and stops."""

    bearing_gain: float = 1.5
    """1/s: angular velocity for a radian of bearing error."""
    distance_gain: float = 1.0
    """1/s: the greatest linear velocity for a metre of distance to the goal."""
    stop_distance_m: float = 0.55
    """The least distance to leave ahead of the robot's centre: the .30 m of the paper's collision, .20 m by which a
    body reaches beyond the shins that the lidar sees, and a little."""
    way_half_width_m: float = 0.35
    """What lies further aside is not in the way: the .30 m of the paper's collision, and a little."""
    reaction_time_s: float = 0.2
    """From a surface coming in sight to the brakes taking hold: a control step, and one of delay (`dynamic`)."""

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            require(getattr(self, name) > 0, f"GoToGoalConfig.{name}", getattr(self, name), "positive")


class GoToGoal:
    """Drives at the goal, with no obstacle avoidance but an emergency stop on the front of the scan."""

    name = "go-to-goal"
    privileged = False

    def __init__(
        self,
        robot: RobotConfig = RobotConfig(),
        lidar: LidarConfig = LidarConfig(),
        config: GoToGoalConfig | None = None,
    ) -> None:
        self.robot = robot
        self.config = config or GoToGoalConfig()
        self._ray_directions = np.stack([np.cos(lidar.angles_rad), np.sin(lidar.angles_rad)], axis=-1)  # [rays, 2]

    def reset(self, which: Bool[np.ndarray, "B"]) -> None:
        """Does nothing: each command follows from one frame."""

    def act(self, frame: SensorFrame) -> Command:
        """The command for each world.

        Raises:
            ValueError: when the scan has another number of rays than the lidar that this navigator was made for.
        """
        num_rays = len(self._ray_directions)
        require(frame.scan_m.shape[1] == num_rays, "rays of the scan", frame.scan_m.shape[1], f"{num_rays}")
        distance, bearing = goal_polar(frame.odom_pose, frame.goal_odom)
        free = free_distance(frame.scan_m, self._ray_directions, self.config.way_half_width_m)
        to_brake_in = free - self.config.stop_distance_m
        limit = self.robot.max_angular_velocity
        linear = np.minimum(
            self._speed_towards_goal(distance, bearing),
            braking_speed(to_brake_in, self.robot.max_linear_acceleration, self.config.reaction_time_s),
        )
        angular = np.clip(self.config.bearing_gain * bearing, -limit, limit)
        return Command(linear.astype(np.float32), angular.astype(np.float32))

    def _speed_towards_goal(
        self, distance: Float[np.ndarray, "B"], bearing: Float[np.ndarray, "B"]
    ) -> Float[np.ndarray, "B"]:
        """Slow when the goal is near or aside, and never so fast that the tightest arc leads around it.

        The arc that is tangent to the heading and meets a goal at distance d and bearing b has the radius
        d / (2 sin b); driven at the greatest angular velocity w it takes v = w d / (2 sin b).
        """
        aside = np.maximum(np.cos(bearing), 0.0)
        arc = self.robot.max_angular_velocity * distance / (2 * np.maximum(np.abs(np.sin(bearing)), 1e-6))
        near = self.config.distance_gain * distance
        return np.minimum(np.minimum(self.robot.max_linear_velocity * aside, arc), near)


def free_distance(
    scan_m: Float[np.ndarray, "B rays"], ray_directions: Float[np.ndarray, "rays 2"], half_width_m: float
) -> Float[np.ndarray, "B"]:
    """How far ahead the nearest scanned point lies within `half_width_m` of the line that the robot looks along.

    Args:
        scan_m: Ranges, +inf where nothing is.
        ray_directions: Unit vectors of the rays in the robot frame.
        half_width_m: Half the width of the way that must be free.

    Returns:
        Metres from the robot's centre; +inf where the way is free.
    """
    # Infinite ranges would make NaN of a ray that points exactly ahead.
    ranges = np.where(np.isfinite(scan_m), scan_m, 1e9)
    forward, beside = ranges * ray_directions[:, 0], np.abs(ranges * ray_directions[:, 1])
    in_the_way = np.isfinite(scan_m) & (forward > 0) & (beside < half_width_m)
    return np.where(in_the_way, forward, np.inf).min(axis=1)


def braking_speed(
    distance_m: Float[np.ndarray, "B"], deceleration: float, reaction_time_s: float
) -> Float[np.ndarray, "B"]:
    """The greatest speed from which the robot comes to rest within `distance_m`.

    It solves v t + v^2 / (2 a) = d, the stopping distance of a robot that keeps its speed for the reaction time t.
    """
    reach = np.maximum(distance_m, 0.0)
    lag = deceleration * reaction_time_s
    return np.sqrt(lag**2 + 2 * deceleration * reach) - lag
