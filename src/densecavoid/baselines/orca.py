"""ORCA as a navigator (van den Berg, Guy, Lin, Manocha, ISRR 2011), for two wheels as NH-ORCA does it (Alonso-Mora,
Breitenmoser, Rufli, Beardsley, Siegwart, DARS 2010).

The robot is grown by the greatest error with which it follows a velocity that points elsewhere, and only velocities
that it can follow within this error are chosen. `orca` knows tracked people, `orca-privileged` everybody there is; what
else the lidar meets stands still. It wishes to go to the next place on the way past what has been seen: alone, the
method stands still before whatever is broader than a person.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from densecavoid.baselines.surroundings import PeopleAround, ScanPoints, WayAround
from densecavoid.baselines.unicycle import TurningConfig, follow_velocity
from densecavoid.frames import CameraConfig, Command, LidarConfig, RobotConfig, SensorFrame, require
from densecavoid.sim._jit import kernel
from densecavoid.sim.crowds.orca import avoid_disc, nearest_velocity


@dataclass(frozen=True)
class OrcaConfig:
    """Horizons and sizes: the best of a short search on training worlds and places
    (`python benchmarks/tune_baselines.py orca --candidates 7 --worlds 4`)."""

    horizon_s: float = 7.0
    """Collisions with people within this time are avoided,"""
    thing_horizon_s: float = 1.0
    """and with what stands within this time."""
    responsibility: float = 0.85
    """Share of the avoiding that the robot does: .5 among people who do the other half, 1 among those who do not."""
    body_m: float = 0.30
    """The robot's radius: the paper's collision distance."""
    tracking_error_m: float = 0.1
    """By which it is grown, and which limits the velocities it may choose (NH-ORCA's epsilon)."""
    unseen_m: float = 0.16
    """What things and unknown people reach beyond what the lidar sees of them at .26 m."""
    sight_m: float = 6.0
    """People farther away are not thought of."""
    people: int = 12
    """So many of the nearest are."""

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            value = getattr(self, name)
            require(value > 0 and math.isfinite(value), f"OrcaConfig.{name}", value, "positive")
        require(self.responsibility <= 1, "OrcaConfig.responsibility", self.responsibility, "in (0, 1]")


_SECTORS = 24
_PLANES_OF_ROBOT = 8


def followable(error_m: float, robot: RobotConfig, turning: TurningConfig) -> Float[np.ndarray, "n 4"]:
    """Half planes, rows (point x, y, inward normal x, y), whose common velocities the robot follows within an error.

    `follow_velocity` turns by min(w, a / T) while an angle of a is left, and is carried off the line by v a meanwhile
    (sin a < a): in all by v a T from a small angle, from one of more than w T by v (a^2 + (w T)^2) / (2 w). The half
    planes are the sides of a polygon with corners on the curve on which that is the error.
    """
    turn, seconds = robot.max_angular_velocity, turning.turn_time_s
    full = error_m / robot.max_linear_velocity  # m off the line for each m/s, at which full speed is still allowed
    widest = full / seconds if full <= turn * seconds**2 else math.sqrt(2 * turn * full - (turn * seconds) ** 2)
    angles = np.unique(np.append(np.linspace(0.0, math.pi, _PLANES_OF_ROBOT // 2 + 1), min(widest, math.pi)))
    off = np.where(angles < turn * seconds, angles * seconds, (angles**2 + (turn * seconds) ** 2) / (2 * turn))
    speeds = np.minimum(robot.max_linear_velocity, error_m / np.maximum(off, 1e-9))
    upper = np.stack([speeds * np.cos(angles), speeds * np.sin(angles)], axis=1)
    corners = np.concatenate([upper, upper * [1.0, -1.0]])
    hull = corners[_hull(corners)]
    side = np.roll(hull, -1, axis=0) - hull
    normal = np.stack([-side[:, 1], side[:, 0]], axis=1) / np.linalg.norm(side, axis=1, keepdims=True)
    return np.concatenate([hull, normal], axis=1)


def _hull(points: Float[np.ndarray, "n 2"]) -> list[int]:
    """Indices of the convex hull, counter-clockwise (Andrew 1979)."""
    order = np.lexsort((points[:, 1], points[:, 0])).tolist()

    def chain(indices: list[int]) -> list[int]:
        kept: list[int] = []
        for k in indices:
            while len(kept) >= 2:
                (ax, ay), (bx, by) = points[kept[-1]] - points[kept[-2]], points[k] - points[kept[-1]]
                if ax * by - ay * bx > 1e-9:
                    break
                kept.pop()
            kept.append(k)
        return kept[:-1]

    return chain(order) + chain(order[::-1])


@kernel
def choose_velocities(wish, own, pos, vel, radius, there, points, robot_planes, limit, dt, sizes, people, out):
    """Writes the velocity of each world that ORCA chooses into `out` [B, 2], all in the robot's frame.

    Args:
        wish, own: f64 [B, 2].
        pos, vel: f64 [B, P, 2]; radius: f64 [B, P]; there: bool [B, P].
        points: f64 [B, S, 2] of what stands, NaN for none.
        robot_planes: f64 [n, 4] half planes of what the robot can follow; kept whatever happens.
        limit: greatest speed.
        sizes: radius to people and to points, horizons for them, responsibility, sight.
        people: how many of the nearest are thought of.
    """
    body, body_to_things, horizon, thing_horizon, responsibility, sight = sizes
    planes = np.empty((robot_planes.shape[0] + points.shape[1] + people, 4))
    chosen = np.empty(people, np.int64)
    for b in range(wish.shape[0]):
        count = robot_planes.shape[0]
        planes[:count] = robot_planes
        hard = count
        for n in range(points.shape[1]):
            x, y = points[b, n, 0], points[b, n, 1]
            if np.isnan(x):
                continue
            distance = max(math.sqrt(x * x + y * y), 1e-6)
            # Towards a point no faster than brings the robot to it in the horizon; out of it within that, too.
            towards = (distance - body_to_things) / thing_horizon
            planes[count, 0], planes[count, 1] = towards * x / distance, towards * y / distance
            planes[count, 2], planes[count, 3] = -x / distance, -y / distance
            count += 1
        taken = 0
        for _ in range(people):
            least, nearest = sight * sight, -1
            for i in range(pos.shape[1]):
                distance_2 = pos[b, i, 0] * pos[b, i, 0] + pos[b, i, 1] * pos[b, i, 1]
                known = not there[b, i]
                for k in range(taken):
                    known = known or chosen[k] == i
                if not known and distance_2 < least:
                    least, nearest = distance_2, i
            if nearest < 0:
                break
            chosen[taken] = nearest
            taken += 1
        for k in range(taken):
            i = chosen[k]
            cx, cy, nx, ny = avoid_disc(
                pos[b, i, 0],
                pos[b, i, 1],
                own[b, 0] - vel[b, i, 0],
                own[b, 1] - vel[b, i, 1],
                body + radius[b, i],
                horizon,
                dt,
            )
            planes[count, 0], planes[count, 1] = own[b, 0] + responsibility * cx, own[b, 1] + responsibility * cy
            planes[count, 2], planes[count, 3] = nx, ny
            count += 1
        nearest_velocity(planes, count, hard, limit, wish[b, 0], wish[b, 1], out[b])


class Orca:
    """Satisfies `frames.Navigator`. Sees people (`source`), the scan, its odometry and the goal."""

    def __init__(
        self,
        robot: RobotConfig = RobotConfig(),
        lidar: LidarConfig = LidarConfig(),
        camera: CameraConfig = CameraConfig(),
        config: OrcaConfig | None = None,
        source: Literal["tracks", "truth"] = "tracks",
        control_dt_s: float = 0.1,
    ) -> None:
        self.name = "orca" if source == "tracks" else "orca-privileged"
        self.robot = robot
        self.config = config or OrcaConfig()
        self._turning = TurningConfig()
        self._dt_s = control_dt_s
        self._people = PeopleAround(source, lidar, camera)
        self._scan = ScanPoints(lidar, min(_SECTORS, lidar.num_rays))
        self._way = WayAround(robot, lidar, camera, control_dt_s)
        self._planes = followable(self.config.tracking_error_m, robot, self._turning)

    @property
    def privileged(self) -> bool:
        """As the source of its people is."""
        return self._people.privileged

    def reset(self, which: Bool[np.ndarray, "B"]) -> None:
        """Forgets the marked worlds."""
        self._people.reset(which)
        self._way.reset(which)

    def act(self, frame: SensorFrame) -> Command:
        """The command for each world.

        Raises:
            ValueError: for a frame that does not fit the sensors that this navigator was made for.
        """
        config, limit = self.config, self.robot.max_linear_velocity
        people = self._people.see(frame)
        distance, bearing = self._way.see(frame, people)
        wish = np.minimum(limit, distance)[:, None] * np.stack([np.cos(bearing), np.sin(bearing)], axis=1)
        own = np.stack([frame.velocity[:, 0].astype(np.float64), np.zeros(frame.num_worlds)], axis=1)
        grown = config.body_m + config.tracking_error_m
        sizes = (
            grown,
            config.body_m + config.unseen_m,
            config.horizon_s,
            config.thing_horizon_s,
            config.responsibility,
            config.sight_m,
        )
        velocity = np.zeros((frame.num_worlds, 2))
        points = self._scan.of(frame.scan_m, people)
        known = people.pos_r, people.vel_r, people.radius_m, people.there
        choose_velocities(wish, own, *known, points, self._planes, limit, self._dt_s, sizes, config.people, velocity)
        return follow_velocity(velocity, bearing, self.robot, self._turning)
