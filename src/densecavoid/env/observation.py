"""From sensor frames to the policy's observation: scan history, nearness image and the prediction frame.

The same observer serves training, benchmark and robot; it keeps one memory for each world.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool

from densecavoid.frames import COMMAND_GRID, NUM_SCANS, Observation, RobotConfig, SensorFrame, goal_polar, require
from densecavoid.perception.config import PerceptionConfig, check_ahead
from densecavoid.perception.foretold_scans import draw_foretold_scans
from densecavoid.perception.memory import ThingsRemembered
from densecavoid.perception.networks import PeopleNetworks
from densecavoid.perception.outlook import OBSERVED, Outlook
from densecavoid.perception.people_around import people_of
from densecavoid.perception.pipeline import PeoplePipeline, expect_people
from densecavoid.perception.predictor.registry import make_predictor
from densecavoid.perception.route import Route
from densecavoid.perception.tracks import Tracks
from densecavoid.sim._jit import for_worlds, kernel, threads_for


@dataclass(frozen=True)
class ObserverConfig(PerceptionConfig):
    """What the policy gets to see: the sensors as they are, and people as they are perceived."""

    robot: RobotConfig = field(default_factory=RobotConfig)
    """Whose height says what is in its way, and whose limits what it can do."""
    remembers: bool = False
    """Whether the oldest of the three scans gives way to things that the camera saw before (`ThingsRemembered`)."""
    foretold_s: tuple[float, ...] = ()
    """So far ahead people are shown as further scans (`foretold_scans`), if they walk on as they do: learned predictors
    do not look so far. None: not at all."""
    route_every_s: float = 0.0
    """So often the way to the goal past what has been seen is looked for, and the place some way along it is shown for
    the goal (`perception.route`); 0: the goal itself is shown."""
    weighs_commands: bool = False
    """Whether the policy is told what commands would be worth in what is known around (`perception.outlook`); needs
    the ways of `route_every_s`."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.foretold_s:
            check_ahead("foretold_s", self.foretold_s)
        require(0 <= self.route_every_s <= 10, "ObserverConfig.route_every_s", self.route_every_s, "0 to 10 s")
        weighs = self.weighs_commands
        require(
            not weighs or self.route_every_s > 0, "ObserverConfig.weighs_commands", weighs, "a route_every_s with it"
        )

    @property
    def num_scans(self) -> int:
        """Scans in an observation."""
        return NUM_SCANS + len(self.foretold_s)


@kernel
def _observe(
    first,
    last,
    which,
    fresh,
    scan,
    depth,
    lidar_range,
    camera_min,
    camera_max,
    lidar,
    camera,
):
    """Shifts the scans and turns depth into nearness."""
    scale = np.float32(254.0 / (camera_max - camera_min))
    for b in range(first, last):
        if not which[b]:
            continue
        for r in range(scan.shape[1]):
            near = min(scan[b, r] / lidar_range, np.float32(1.0))
            if fresh[b]:
                lidar[b, 0, r] = lidar[b, 1, r] = near
            else:
                lidar[b, 0, r], lidar[b, 1, r] = lidar[b, 1, r], lidar[b, 2, r]
            lidar[b, 2, r] = near
        for v in range(depth.shape[1]):
            for u in range(depth.shape[2]):
                d = depth[b, v, u]
                inside = camera_min <= d <= camera_max  # NaN is not
                camera[b, v, u] = np.uint8(1.5 + scale * (camera_max - d)) if inside else np.uint8(0)


class Observer:
    """Turns frames into observations, one memory a world."""

    def __init__(self, config: ObserverConfig, num_worlds: int, networks: PeopleNetworks = PeopleNetworks()) -> None:
        require(num_worlds >= 1, "num_worlds", num_worlds, "at least 1")
        self.config = config
        self.num_worlds = num_worlds
        self.privileged = config.privileged
        self.people = PeoplePipeline(config, num_worlds, networks=networks)
        """Who is seen, followed and foreseen."""
        sensors = config.lidar, config.camera
        self._things = (
            ThingsRemembered(*sensors, num_worlds, config.threads, config.robot) if config.remembers else None
        )
        every = max(1, round(config.route_every_s / config.control_dt_s))
        of_route = *sensors, every, num_worlds, config.threads, config.robot
        self._route = Route(*of_route) if config.route_every_s > 0 else None
        self._outlook = Outlook(OBSERVED, config.robot, config.threads) if config.weighs_commands else None
        self._worth = np.zeros((num_worlds, len(COMMAND_GRID)), np.float32)
        self._walking_on = make_predictor("constant-velocity")
        self._fresh = np.ones(num_worlds, np.bool_)
        self._lidar = np.ones((num_worlds, config.num_scans, config.lidar.num_rays), np.float32)
        self._camera = np.zeros((num_worlds, config.camera.height, config.camera.width), np.uint8)

    @property
    def tracks(self) -> Tracks:
        """Everybody tracked now."""
        return self.people.tracks

    def reset(self, which: Bool[np.ndarray, "B"]) -> None:
        """Forgets the past of the marked worlds."""
        self._fresh[which] = True
        self.people.reset(which)
        if self._things is not None:
            self._things.reset(which)
        if self._route is not None:
            self._route.reset(which)

    def observe(self, frame: SensorFrame, which: Bool[np.ndarray, "B"] | None = None) -> Observation:
        """Takes in the next frame of the marked worlds (all, without `which`).

        Returns:
            The observation of all worlds, in buffers that the next call writes again.

        Raises:
            ValueError: if the frame does not fit the configured sensors, or lacks the truth that they need.
        """
        config = self.config
        self._check(frame)
        which = np.ones(self.num_worlds, np.bool_) if which is None else which
        threads = threads_for(which, config.threads)
        for_worlds(
            _observe,
            self.num_worlds,
            threads,
            which,
            self._fresh,
            frame.scan_m,
            frame.depth_m,
            np.float32(config.lidar.max_range_m),
            np.float32(config.camera.min_range_m),
            np.float32(config.camera.max_range_m),
            self._lidar,
            self._camera,
        )
        if self._things is not None:
            self._things.update(frame, which, self._lidar[:, 0])
        self.people.update(frame, which)
        if config.foretold_s:
            expected = expect_people(self.tracks, self._walking_on, config.foretold_s, which)
            scans = self._lidar[:, NUM_SCANS:]
            where = frame.odom_pose, float(config.lidar.fov_rad)
            for_worlds(draw_foretold_scans, self.num_worlds, threads, which, scans, expected, *where)
        self._fresh[which] = False
        if self._route is None:
            distance, bearing = goal_polar(frame.odom_pose, frame.goal_odom)
        else:
            people = people_of(self.tracks, frame, standing=True)
            distance, bearing = self._route.update(frame, people, which)
            if self._outlook is not None:
                self._worth[which] = 0.0
                self._outlook.look(self._route.around(frame, people), which & np.isfinite(distance), self._worth)
        return Observation(
            lidar=self._lidar,
            camera=self._camera,
            goal=np.stack([distance, bearing], axis=1).astype(np.float32),
            velocity=frame.velocity.astype(np.float32),
            prediction=self.people.prediction,
            worth=self._worth,
        )

    def state_dict(self) -> dict[str, np.ndarray]:
        """The memory of all worlds, as arrays."""
        people = {f"people.{name}": value for name, value in self.people.state_dict().items()}
        own = {"fresh": self._fresh.copy(), "lidar": self._lidar.copy(), "camera": self._camera.copy()}
        own["worth"] = self._worth.copy()
        things = {} if self._things is None else self._things.state_dict()
        route = {} if self._route is None else self._route.state_dict()
        things = {f"things.{name}": value for name, value in things.items()}
        return people | own | things | {f"route.{name}": value for name, value in route.items()}

    def load_state_dict(self, arrays: dict[str, np.ndarray]) -> None:
        """Goes on from a `state_dict`."""
        require(len(arrays["fresh"]) == self.num_worlds, "saved worlds", len(arrays["fresh"]), str(self.num_worlds))
        self.people.load_state_dict(_part(arrays, "people."))
        if self._things is not None:
            self._things.load_state_dict(_part(arrays, "things."))
        if self._route is not None:
            self._route.load_state_dict(_part(arrays, "route."))
        self._fresh, self._lidar = np.array(arrays["fresh"]), np.array(arrays["lidar"])
        self._camera, self._worth = np.array(arrays["camera"]), np.array(arrays["worth"])

    def _check(self, frame: SensorFrame) -> None:
        camera = self.config.camera
        scan_shape = (self.num_worlds, self.config.lidar.num_rays)
        depth_shape = (self.num_worlds, camera.height, camera.width)
        require(frame.scan_m.shape == scan_shape, "scan_m", frame.scan_m.shape, str(scan_shape))
        require(frame.depth_m.shape == depth_shape, "depth_m", frame.depth_m.shape, str(depth_shape))


def _part(arrays: dict[str, np.ndarray], prefix: str) -> dict[str, np.ndarray]:
    return {name.removeprefix(prefix): value for name, value in arrays.items() if name.startswith(prefix)}
