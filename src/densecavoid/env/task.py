"""The navigation task: simulator, observer and reward as one batch, without deciding when an episode begins anew."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from gymnasium import spaces
from jaxtyping import Bool, Float, Float32

from densecavoid.env.observation import Observer, ObserverConfig
from densecavoid.env.reward import RewardConfig, Transition, reward_terms
from densecavoid.frames import COMMAND_GRID, NUM_SCANS, Command, Observation, require
from densecavoid.sim.spec import Scenario
from densecavoid.sim.world import SimConfig, Simulator

_FARTHEST_GOAL_M = 1000.0


class StepResult(NamedTuple):
    """What one control step brought."""

    observation: Observation
    reward: Float32[np.ndarray, "B"]
    terminated: Bool[np.ndarray, "B"]
    """Collision or goal."""
    truncated: Bool[np.ndarray, "B"]
    """The time limit alone."""
    terms: dict[str, Float[np.ndarray, "B"]]


class NavigationTask:
    """B robots, each in its own world, to be driven to their goals."""

    def __init__(
        self,
        scenario: Scenario,
        num_worlds: int,
        sim: SimConfig | None = None,
        observer: ObserverConfig | None = None,
        reward: RewardConfig | None = None,
        seed: int = 0,
        first_world: int = 0,
    ) -> None:
        """Makes the worlds; `reset` draws the first episodes.

        Args:
            scenario: where worlds are drawn from.
            num_worlds: B.
            sim: the body; the observer's sensors follow it when `observer` is not given.
            observer: what is seen.
            reward: weights.
            seed: worlds are drawn from (seed, world, episode), so they do not depend on B.
            first_world: number of the first world, where these are a part of more worlds.
        """
        sim = sim or SimConfig()
        observer = observer or ObserverConfig(
            sim.lidar, sim.camera, control_dt_s=sim.control_dt_s, robot=sim.robot, threads=sim.threads
        )
        require(observer.lidar == sim.lidar, "ObserverConfig.lidar", observer.lidar, f"the simulator's {sim.lidar}")
        require(
            observer.camera == sim.camera, "ObserverConfig.camera", observer.camera, f"the simulator's {sim.camera}"
        )
        self.simulator = Simulator(scenario, num_worlds, sim)
        self.observer = Observer(observer, num_worlds)
        self.reward = reward or RewardConfig()
        self.seed = seed
        self.first_world = first_world
        self._episode = np.zeros(num_worlds, np.int64)
        self._distance = np.zeros(num_worlds)
        self._angular = np.zeros(num_worlds)
        self._visited = np.zeros((num_worlds, 0), np.bool_)

    @property
    def num_worlds(self) -> int:
        return self.simulator.num_worlds

    def reseed(self, seed: int) -> None:
        """Begins a new sequence of worlds with the next reset."""
        self.seed = seed
        self._episode[:] = 0

    def reset(self, which: Bool[np.ndarray, "B"]) -> Observation:
        """Draws the next episode of the marked worlds and looks at it."""
        seeds = np.zeros(self.num_worlds, np.int64)
        for b in np.flatnonzero(which):
            key = np.random.SeedSequence([self.seed, self.first_world + int(b), int(self._episode[b])])
            seeds[b] = key.generate_state(1, np.uint64)[0] >> np.uint64(1)
        self._episode[which] += 1
        self.simulator.reset(seeds, which)
        self.observer.reset(which)
        self._distance[which] = self.simulator.goal_distance_m[which]
        self._angular[which] = 0.0
        points, _ = self.simulator.waypoints
        if points.shape[1] > self._visited.shape[1]:
            room = points.shape[1] - self._visited.shape[1]
            self._visited = np.pad(self._visited, ((0, 0), (0, room)))
        self._visited[which] = False
        return self.observer.observe(self.simulator.sense(which), which)

    def step(self, action: Float[np.ndarray, "B 2"]) -> StepResult:
        """Drives every robot for one control step with (linear, angular) velocities.

        Raises:
            ValueError: if a velocity is not finite.
        """
        sim = self.simulator
        sim.step(Command(np.asarray(action[:, 0], np.float32), np.asarray(action[:, 1], np.float32)))
        frame = sim.sense()
        observation = self.observer.observe(frame)
        distance, angular = sim.goal_distance_m, sim.robot_velocity[:, 1].copy()
        max_range = sim.config.lidar.max_range_m
        transition = Transition(
            distance_before_m=self._distance,
            distance_m=distance,
            succeeded=sim.succeeded,
            reached_waypoint=self._reach_waypoints(),
            collided=sim.collided,
            angular_before=self._angular,
            angular=angular,
            clearance_m=sim.clearance_m,
            lidar_shortfall_m=max_range - np.minimum(frame.scan_m.min(axis=1), max_range),
        )
        terms = reward_terms(self.reward, transition)
        self._distance, self._angular = distance, angular
        return StepResult(
            observation=observation,
            reward=np.sum(list(terms.values()), axis=0).astype(np.float32),
            terminated=sim.collided | sim.succeeded,
            truncated=sim.timed_out,
            terms=terms,
        )

    def state_dict(self) -> dict[str, np.ndarray]:
        """Everything that decides how the worlds go on, as arrays."""
        arrays = {f"simulator.{name}": value for name, value in self.simulator.state_dict().items()}
        arrays |= {f"observer.{name}": value for name, value in self.observer.state_dict().items()}
        return arrays | {
            "seed": np.array(self.seed),
            "episode": self._episode.copy(),
            "distance": self._distance.copy(),
            "angular": self._angular.copy(),
            "visited": self._visited.copy(),
        }

    def load_state_dict(self, arrays: dict[str, np.ndarray]) -> None:
        """Goes on from a `state_dict` of a task with as many worlds and the same sensors."""
        for part in ("simulator", "observer"):
            prefix = f"{part}."
            getattr(self, part).load_state_dict(
                {name.removeprefix(prefix): value for name, value in arrays.items() if name.startswith(prefix)}
            )
        self.seed = int(arrays["seed"])
        self._episode, self._visited = np.array(arrays["episode"]), np.array(arrays["visited"])
        self._distance, self._angular = np.array(arrays["distance"]), np.array(arrays["angular"])

    def _reach_waypoints(self) -> Bool[np.ndarray, "B"]:
        """Marks waypoints that the robot is at; True for worlds where one was reached for the first time."""
        points, count = self.simulator.waypoints
        offset = points - self.simulator.robot_pose[:, None, :2]
        near = np.hypot(offset[..., 0], offset[..., 1]) < self.reward.waypoint_distance_m
        near &= np.arange(points.shape[1]) < count[:, None]
        new = near & ~self._visited
        self._visited |= near
        return new.any(axis=1)


def observation_space(config: SimConfig, num_scans: int = NUM_SCANS) -> spaces.Space:
    """o = [lidar, camera, goal, velocity, prediction, worth] of one robot (frames.Observation)."""
    robot, image = config.robot, (config.camera.height, config.camera.width)
    limit = np.array([robot.max_linear_velocity, robot.max_angular_velocity], np.float32)
    return spaces.Dict(
        {
            "lidar": spaces.Box(0.0, 1.0, (num_scans, config.lidar.num_rays), np.float32),
            "camera": spaces.Box(0, 255, image, np.uint8),
            "goal": spaces.Box(
                np.array([0.0, -np.pi], np.float32), np.array([_FARTHEST_GOAL_M, np.pi], np.float32), dtype=np.float32
            ),
            "velocity": spaces.Box(-limit, limit, dtype=np.float32),
            "prediction": spaces.Box(0, 255, image, np.uint8),
            "worth": spaces.Box(-1.0, 1.0, (len(COMMAND_GRID),), np.float32),
        }
    )


def action_space(config: SimConfig) -> spaces.Box:
    """(linear m/s, angular rad/s) of one robot."""
    v, w = config.robot.max_linear_velocity, config.robot.max_angular_velocity
    return spaces.Box(np.array([0.0, -w], np.float32), np.array([v, w], np.float32), dtype=np.float32)
