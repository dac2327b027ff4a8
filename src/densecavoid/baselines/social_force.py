"""The social force model as a navigator (Helbing, Molnar, Phys. Rev. E 51, 1995): pulled to the next place
on the way to the goal past what has been seen, pushed by people and by what the lidar meets; the velocity that comes of
it is followed on two wheels."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from densecavoid.baselines.surroundings import PeopleAround, ScanPoints, WayAround
from densecavoid.baselines.unicycle import TurningConfig, follow_velocity
from densecavoid.frames import CameraConfig, Command, LidarConfig, RobotConfig, SensorFrame, require
from densecavoid.perception.people_around import People


@dataclass(frozen=True)
class SocialForceConfig:
    """Strengths and ranges of the forces. Those of walking people (paper, section II) are far too short for a robot
    that turns at .4 rad/s; these are the best of a short search on training worlds and places
    (`python benchmarks/tune_baselines.py social-force --candidates 7 --worlds 4`)."""

    relaxation_s: float = 0.63
    """tau: in which the velocity becomes the wished one."""
    people_m_s2: float = 1.6
    """Strength of a person's push at the outline of both bodies,"""
    people_range_m: float = 1.2
    """and the distance in which it falls to 1/e."""
    foresight_s: float = 3.8
    """People push from the ellipse that their next way of this time (relative to the robot) spans."""
    things_m_s2: float = 2.4
    """The same of a point of the scan,"""
    things_range_m: float = 0.28
    rear: float = 0.5
    """Share of a push from behind."""
    body_m: float = 0.30
    """The robot's radius, as far as pushes are concerned: the paper's collision distance."""

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            value = getattr(self, name)
            require(value > 0 and math.isfinite(value), f"SocialForceConfig.{name}", value, "positive")


_SECTORS = 24


class SocialForce:
    """Satisfies `frames.Navigator`. Sees tracked people, the scan, its odometry and the goal."""

    name = "social-force"

    def __init__(
        self,
        robot: RobotConfig = RobotConfig(),
        lidar: LidarConfig = LidarConfig(),
        camera: CameraConfig = CameraConfig(),
        config: SocialForceConfig | None = None,
    ) -> None:
        self.robot = robot
        self.config = config or SocialForceConfig()
        self._people = PeopleAround("tracks", lidar, camera)
        self._scan = ScanPoints(lidar, min(_SECTORS, lidar.num_rays))
        self._way = WayAround(robot, lidar, camera)

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
        config = self.config
        people = self._people.see(frame)
        points = self._scan.of(frame.scan_m, people)
        distance, bearing = self._way.see(frame, people)
        to_goal = np.stack([np.cos(bearing), np.sin(bearing)], axis=1)
        own = np.stack([frame.velocity[:, 0].astype(np.float64), np.zeros(frame.num_worlds)], axis=1)
        speed = np.minimum(self.robot.max_linear_velocity, distance)
        force = (speed[:, None] * to_goal - own) / config.relaxation_s
        force += self._push_of_people(people, own) + self._push_of_things(points)
        return follow_velocity(own + config.relaxation_s * force, bearing, self.robot, TurningConfig())

    def _push_of_people(self, people: People, own: Float[np.ndarray, "B 2"]) -> Float[np.ndarray, "B 2"]:
        """Minus the gradient of V exp(-(b - b0) / sigma), b the semi-minor axis of the ellipse through the robot
        whose foci are the person and where they will be, relative to the robot (equations 3 and 4 there)."""
        config = self.config
        offset = -people.pos_r  # from the person to the robot
        step = config.foresight_s * (people.vel_r - own[:, None])
        ahead = offset - step
        near = np.maximum(np.linalg.norm(offset, axis=-1), 1e-6)
        far = np.maximum(np.linalg.norm(ahead, axis=-1), 1e-6)
        minor = 0.5 * np.sqrt(np.maximum((near + far) ** 2 - (step**2).sum(axis=-1), 1e-6))
        # The ellipse of someone who stands is a circle, and minor their distance: pushes begin at the outlines.
        size = config.people_m_s2 * np.exp((people.radius_m + config.body_m - minor) / config.people_range_m)
        size = np.minimum(size, 10 * config.people_m_s2) * (near + far) / (4.0 * minor)
        push = size[..., None] * (offset / near[..., None] + ahead / far[..., None])
        push *= np.where(people.pos_r[..., :1] < 0.0, config.rear, 1.0)
        return np.where(people.there[..., None], push, 0.0).sum(axis=1)

    def _push_of_things(self, points: Float[np.ndarray, "B S 2"]) -> Float[np.ndarray, "B 2"]:
        """From each sector's nearest point, by its share of the whole: a wall pushes as one, however many see it."""
        config = self.config
        distance = np.maximum(np.linalg.norm(points, axis=-1), 1e-6)
        size = config.things_m_s2 * np.exp((config.body_m - distance) / config.things_range_m)
        push = -np.nan_to_num(size[..., None] * points / distance[..., None])
        total = push.sum(axis=1)
        # No more than the strongest single push: many points of one wall are one wall.
        strongest = np.linalg.norm(push, axis=-1).max(axis=1)
        length = np.maximum(np.linalg.norm(total, axis=-1), 1e-6)
        return total * np.minimum(1.0, strongest / length)[:, None]
