"""The dynamic window approach on the lidar (Fox, Burgard, Thrun, IEEE Robotics & Automation Magazine 4, 1997).

Arcs of constant velocities are followed some seconds ahead among the points of the present scan, which are taken to
stand still. Of those from which the robot can still stop, the one with the best sum of progress, heading, clearance and
speed is driven for one control step. Progress and heading are towards the next place on the way to the goal past what
has been seen, or, where the straight way there is not free, towards the end of the free straight way that deviates
least: alone, the method stands still before whatever is broader than it can see past.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool

from densecavoid.baselines.surroundings import ScanPoints, WayAround
from densecavoid.frames import CameraConfig, Command, LidarConfig, RobotConfig, SensorFrame, require
from densecavoid.perception.people_around import nobody
from densecavoid.perception.route import AHEAD_M
from densecavoid.sim._jit import kernel


@dataclass(frozen=True)
class DwaConfig:
    """Weights of the objective, and what is sampled. Set by hand; `python benchmarks/tune_baselines.py dwa` looks for
    better ones on training worlds and places."""

    horizon_s: float = 2.5
    """So far ahead arcs are followed."""
    step_s: float = 0.25
    """Between the places on an arc that are looked at."""
    linear_samples: int = 9
    angular_samples: int = 13
    window_s: float = 0.5
    """Velocities that the robot's accelerations reach in this time are considered."""
    keep_m: float = 0.38
    """From the robot's centre to the nearest point: nearer is a collision. The paper's .30 m, and part of what bodies
    and furniture reach beyond what the lidar sees of them at .26 m."""
    comfort_m: float = 0.9
    """Points farther away cost nothing."""
    progress: float = 1.0
    """Weight of the way that an arc leaves to the goal, by what could be driven in the time."""
    heading: float = 0.4
    """Of the angle at its end between heading and goal, by pi."""
    clearance: float = 0.8
    """Of how near it comes to a point, from 0 at `comfort_m` to 1 at `keep_m`."""
    speed: float = 0.2
    """Of what lacks of the greatest speed."""
    look_m: float = 1.6
    """So long a straight way is free enough."""
    detour: float = 3.0
    """rad of deviation from the goal that a straight way of `look_m` is worth, beside none."""

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            value = getattr(self, name)
            require(value >= 0 and math.isfinite(value), f"DwaConfig.{name}", value, "0 or more")
        require(self.comfort_m > self.keep_m, "DwaConfig.comfort_m", self.comfort_m, f"above keep_m = {self.keep_m}")
        require(0 < self.step_s <= self.horizon_s, "DwaConfig.step_s", self.step_s, "positive, at most horizon_s")
        for name in ("linear_samples", "angular_samples"):
            require(getattr(self, name) >= 2, f"DwaConfig.{name}", getattr(self, name), "at least 2")


_SECTORS = 96
_BEARINGS = 49
_WIDEST = 2.0  # rad to either side: nearly all that a lidar of 240 degrees sees


@kernel
def free_direction(points, count, goal_x, goal_y, keep, look, detour):
    """A place to drive to, straight and free, near the way to the goal: x and y in the robot's frame.

    Args:
        points: [count or more, 2] of what is in the way.
        keep: half the width that must be free.
    """
    distance, towards = math.sqrt(goal_x * goal_x + goal_y * goal_y), math.atan2(goal_y, goal_x)
    look = min(look, distance)
    best, best_bearing, best_free = np.inf, towards, distance
    for k in range(_BEARINGS + 1):
        bearing = towards if k == _BEARINGS else _WIDEST * (2.0 * k / (_BEARINGS - 1) - 1.0)
        cos, sin = math.cos(bearing), math.sin(bearing)
        free = look
        for n in range(count):
            along, aside = cos * points[n, 0] + sin * points[n, 1], cos * points[n, 1] - sin * points[n, 0]
            if along > 0.0 and abs(aside) < keep:
                free = min(free, max(along - math.sqrt(keep * keep - aside * aside), 0.0))
        off = abs((bearing - towards + math.pi) % (2.0 * math.pi) - math.pi)
        # A little for turning at all, so that the robot does not waver between two ways.
        cost = off + detour * (1.0 - free / look) + 0.15 * abs(bearing)
        if cost < best:
            best, best_bearing, best_free = cost, bearing, free
    # Who must turn looks that way, however little is free there.
    reach = distance if best_bearing == towards and best_free >= look else max(best_free, 0.5)
    return reach * math.cos(best_bearing), reach * math.sin(best_bearing)


@kernel
def best_arcs(
    points, goal, velocity, max_linear, max_angular, linear_acc, angular_acc, horizon, step, window, samples, shape, out
):
    """Writes the best (linear, angular) velocity of each world into `out` [B, 2].

    Args:
        points: f64 [B, S, 2] in the robot's frame, NaN for none.
        goal: f64 [B, 2] in the robot's frame.
        velocity: f64 [B, 2] at present.
        samples: numbers of linear and angular velocities.
        shape: keep, comfort (m), the weights of progress, heading, clearance, speed, and look (m) and detour (rad).
    """
    keep, comfort, w_progress, w_heading, w_clearance, w_speed, look, detour = shape
    num_linear, num_angular = samples
    near = np.empty((points.shape[1], 2))
    steps = int(horizon / step + 0.5)
    for b in range(points.shape[0]):
        reach = comfort + max_linear * horizon
        count, nearest = 0, reach
        for n in range(points.shape[1]):
            x, y = points[b, n, 0], points[b, n, 1]
            if x * x + y * y < reach * reach:  # NaN is not
                near[count, 0], near[count, 1] = x, y
                nearest = min(nearest, math.sqrt(x * x + y * y))
                count += 1
        # Who is too near already may leave, but come no nearer.
        limit = min(keep, nearest - 0.01)
        low_v = max(0.0, velocity[b, 0] - linear_acc * window)
        high_v = min(max_linear, velocity[b, 0] + linear_acc * window)
        low_w = max(-max_angular, velocity[b, 1] - angular_acc * window)
        high_w = min(max_angular, velocity[b, 1] + angular_acc * window)
        goal_x, goal_y = free_direction(near, count, goal[b, 0], goal[b, 1], keep, look, detour)
        before = math.sqrt(goal_x * goal_x + goal_y * goal_y)
        bearing = math.atan2(goal_y, goal_x)
        # With no arc to be had: stop, and turn towards the goal.
        best, best_v, best_w = np.inf, 0.0, min(max(2.0 * bearing, -max_angular), max_angular)
        for iv in range(num_linear):
            v = low_v + (high_v - low_v) * iv / (num_linear - 1)
            to_stop = v * step + v * v / (2.0 * linear_acc)
            for iw in range(num_angular):
                w = low_w + (high_w - low_w) * iw / (num_angular - 1)
                least, left, error = comfort * comfort, before, abs(bearing)
                free = True
                for k in range(1, steps + 1):
                    time = k * step
                    turned = w * time
                    half = 0.5 * turned
                    chord = v * time * (math.sin(half) / half if abs(half) > 1e-6 else 1.0)
                    x, y = chord * math.cos(half), chord * math.sin(half)
                    for n in range(count):
                        off_x, off_y = near[n, 0] - x, near[n, 1] - y
                        least = min(least, off_x * off_x + off_y * off_y)
                    if least < limit * limit:
                        # Nearer than it may come: allowed if the robot can stop before, and worth what it makes until.
                        free = v * (time - step) >= to_stop
                        break
                    off_x, off_y = goal_x - x, goal_y - y
                    left = math.sqrt(off_x * off_x + off_y * off_y)
                    error = abs((math.atan2(off_y, off_x) - turned + math.pi) % (2.0 * math.pi) - math.pi)
                    if left < 0.2:
                        left, error = 0.0, 0.0
                        break
                if not free and v > 1e-6:
                    continue
                nearness = min((comfort - math.sqrt(least)) / (comfort - keep), 1.0)
                cost = w_progress * (left - before) / (max_linear * horizon) + w_heading * error / math.pi
                cost += w_clearance * nearness + w_speed * (1.0 - v / max_linear)
                if cost < best:
                    best, best_v, best_w = cost, v, w
        out[b, 0], out[b, 1] = best_v, best_w


class Dwa:
    """Satisfies `frames.Navigator`. Sees scan, depth image, odometry and goal; nobody is told from things."""

    name = "dwa"
    privileged = False

    def __init__(
        self,
        robot: RobotConfig = RobotConfig(),
        lidar: LidarConfig = LidarConfig(),
        camera: CameraConfig = CameraConfig(),
        config: DwaConfig | None = None,
    ) -> None:
        self.robot = robot
        self.config = config or DwaConfig()
        self._scan = ScanPoints(lidar, min(_SECTORS, lidar.num_rays))
        self._way = WayAround(robot, lidar, camera)

    def reset(self, which: Bool[np.ndarray, "B"]) -> None:
        """Forgets what the marked worlds have shown."""
        self._way.reset(which)

    def act(self, frame: SensorFrame) -> Command:
        """The command for each world.

        Raises:
            ValueError: when the scan has another number of rays than the lidar that this navigator was made for.
        """
        config, robot = self.config, self.robot
        distance, bearing = self._way.see(frame, nobody(frame.num_worlds))
        goal = np.minimum(distance, AHEAD_M)[:, None] * np.stack([np.cos(bearing), np.sin(bearing)], axis=1)
        out = np.zeros((frame.num_worlds, 2))
        best_arcs(
            self._scan.of(frame.scan_m),
            goal,
            frame.velocity.astype(np.float64),
            robot.max_linear_velocity,
            robot.max_angular_velocity,
            robot.max_linear_acceleration,
            robot.max_angular_acceleration,
            config.horizon_s,
            config.step_s,
            config.window_s,
            (config.linear_samples, config.angular_samples),
            (
                config.keep_m,
                config.comfort_m,
                config.progress,
                config.heading,
                config.clearance,
                config.speed,
                config.look_m,
                config.detour,
            ),
            out,
        )
        return Command(out[:, 0].astype(np.float32), out[:, 1].astype(np.float32))
