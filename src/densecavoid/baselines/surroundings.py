"""What classical navigators know of their surroundings: people around, what else the lidar meets, and where the way to
the goal leads past what has been seen, as a navigation stack's global planner tells its local one.

People come from the tracker that the policy uses too, through `PeopleAround` alone; or, for privileged navigators, from
ground truth.
"""

from __future__ import annotations

from functools import partial
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from densecavoid.env.observation import Observer, ObserverConfig
from densecavoid.frames import CameraConfig, LidarConfig, RobotConfig, SensorFrame, choose, goal_polar, require
from densecavoid.perception.outlook_kernels import Around
from densecavoid.perception.people_around import People, people_around, people_of
from densecavoid.perception.route import Route


class PeopleAround:
    """Whom the robot knows of: `tracks` of people its sensors have shown, or everybody there is (`truth`)."""

    def __init__(
        self,
        source: Literal["tracks", "truth"] = "tracks",
        lidar: LidarConfig = LidarConfig(),
        camera: CameraConfig = CameraConfig(),
        standing: bool = False,
    ) -> None:
        """
        Args:
            source: as the class says.
            lidar, camera: whose frames it will be given.
            standing: as in `people_of`.
        """
        self._standing = standing
        self.privileged = choose("source of people", source, ("tracks", "truth")) == "truth"
        """Whether ground truth is read."""
        self._config = ObserverConfig(lidar, camera, people_from="detector")
        self._observer: Observer | None = None

    def reset(self, which: Bool[np.ndarray, "B"]) -> None:
        """Forgets the marked worlds; their number sets the batch size."""
        if self.privileged:
            return
        if self._observer is None or len(which) != self._observer.num_worlds:
            self._observer = Observer(self._config, len(which))
        else:
            self._observer.reset(which)

    def see(self, frame: SensorFrame) -> People:
        """The people of each world after one more frame.

        Raises:
            ValueError: for a frame of another number of worlds than `reset` announced, or without the truth needed.
        """
        if self.privileged:
            require(frame.truth is not None, "truth of the frame", None, "a simulator's, for people from truth")
            assert frame.truth is not None
            people = frame.truth.people
            pose = frame.truth.robot_pose_w
            return people_around(pose, people.pos_w, people.vel_w, people.radius_m, people.active)
        if self._observer is None:
            self._observer = Observer(self._config, frame.num_worlds)
        self._observer.observe(frame)
        return people_of(self._observer.tracks, frame, self._standing)


class WayAround:
    """Where to go next: a place on the shortest way to the goal, as policies are shown it (`perception.route`)."""

    def __init__(
        self,
        robot: RobotConfig,
        lidar: LidarConfig,
        camera: CameraConfig,
        control_dt_s: float = 0.1,
        every_s: float = 0.5,
        threads: int = 0,
    ) -> None:
        """
        Args:
            robot: what begins above its height is in nobody's way.
            lidar, camera: whose frames it will be given.
            control_dt_s: between two frames.
            every_s: so often the way is looked for anew; 0: with every frame.
            threads: over the worlds; 0 takes all cores.
        """
        every_steps = max(1, round(every_s / control_dt_s))
        self._make = partial(Route, lidar, camera, every_steps, threads=threads, robot=robot)
        self._route: Route | None = None
        self._num_worlds = 0

    def reset(self, which: Bool[np.ndarray, "B"]) -> None:
        """Forgets the marked worlds; their number sets the batch size."""
        if self._route is None or len(which) != self._num_worlds:
            self._route, self._num_worlds = self._make(num_worlds=len(which)), len(which)
        else:
            self._route.reset(which)

    def see(self, frame: SensorFrame, people: People) -> tuple[Float[np.ndarray, "B"], Float[np.ndarray, "B"]]:
        """Takes in one more frame.

        Args:
            frame: of the sensors.
            people: who is known: those who stand are in the way, those who walk leave no trail in the map.

        Returns:
            Distance to the goal (m), straight on, and bearing (rad) of the next place.
        """
        if self._route is None:
            self.reset(np.ones(frame.num_worlds, np.bool_))
        assert self._route is not None
        _, bearing = self._route.update(frame, people, np.ones(frame.num_worlds, np.bool_))
        distance, _ = goal_polar(frame.odom_pose, frame.goal_odom)
        return distance, bearing

    def around(self, frame: SensorFrame, people: People) -> Around:
        """What the way was looked for in, after `see` of the same."""
        assert self._route is not None
        return self._route.around(frame, people)


class ScanPoints:
    """The nearest return in each of some sectors of the scan, as points in the robot's frame."""

    def __init__(self, lidar: LidarConfig, sectors: int) -> None:
        require(1 <= sectors <= lidar.num_rays, "sectors", sectors, f"1 to {lidar.num_rays}")
        self._num_rays = lidar.num_rays
        self._rays = np.stack([np.cos(lidar.angles_rad), np.sin(lidar.angles_rad)], axis=-1)
        self._mount = np.array([lidar.mount_x_m, 0.0])
        self._starts = np.linspace(0, lidar.num_rays, sectors, endpoint=False).astype(np.intp)

    def of(
        self, scan_m: Float[np.ndarray, "B rays"], people: People | None = None, margin_m: float = 0.15
    ) -> Float[np.ndarray, "B S 2"]:
        """One point a sector, NaN where there is no return.

        Args:
            scan_m: Ranges, +inf where nothing is.
            people: Returns from them are left out: they are known already.
            margin_m: So far from somebody's outline a return is theirs (legs step beyond it).

        Raises:
            ValueError: for another number of rays than the lidar has.
        """
        require(scan_m.shape[1] == self._num_rays, "rays of the scan", scan_m.shape[1], f"{self._num_rays}")
        ranges = np.where(np.isfinite(scan_m), scan_m, 1e3).astype(np.float64)
        points = ranges[..., None] * self._rays + self._mount
        if people is not None:
            for person in range(people.there.shape[1]):
                here = people.there[:, person]
                if here.any():
                    offset = points - people.pos_r[:, None, person]
                    reach = people.radius_m[:, person] + margin_m
                    theirs = (offset**2).sum(axis=-1) < (reach**2)[:, None]
                    ranges[theirs & here[:, None]] = 1e3
        least = np.minimum.reduceat(ranges, self._starts, axis=1)
        sector = np.repeat(np.arange(len(self._starts)), np.diff([*self._starts, self._num_rays]))
        # The first ray of the sector that has its least range.
        is_least = ranges == least[:, sector]
        index = np.where(is_least, np.arange(self._num_rays), self._num_rays)
        ray = np.minimum.reduceat(index, self._starts, axis=1)
        nearest = least[..., None] * self._rays[ray] + self._mount
        return np.where((least < 1e3)[..., None], nearest, np.nan)
