"""A tiny vector environment with the real one's contract: drive along a line to a goal, seen in `goal` alone."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

RAYS = 16
IMAGE = (4, 8)


class PointEnv(VectorEnv):
    """The robot turns on the spot towards a bearing: reward is the bearing's decrease, success a bearing under .1 rad.

    Linear velocity does nothing but cost: the best policy has v = 0 and turns towards the goal.
    """

    metadata: dict[str, Any] = {"autoreset_mode": AutoresetMode.SAME_STEP}  # noqa: RUF012

    def __init__(
        self, num_envs: int, limit_steps: int = 20, scenario: Any = None, first_world: int = 0, people: int = 0
    ) -> None:
        self.num_envs = num_envs
        self.first_world = first_world
        self.people = people
        self.limit_steps = limit_steps
        self.scenario = scenario
        self.single_observation_space = gym.spaces.Dict(
            {
                "lidar": gym.spaces.Box(0, 1, (3, RAYS), np.float32),
                "camera": gym.spaces.Box(0, 255, IMAGE, np.uint8),
                "goal": gym.spaces.Box(-np.inf, np.inf, (2,), np.float32),
                "velocity": gym.spaces.Box(-np.inf, np.inf, (2,), np.float32),
                "prediction": gym.spaces.Box(0, 255, IMAGE, np.uint8),
                "worth": gym.spaces.Box(-1.0, 1.0, (25,), np.float32),
            }
        )
        self.single_action_space = gym.spaces.Box(np.array([0, -0.4], np.float32), np.array([1, 0.4], np.float32))
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.bearing = np.zeros(num_envs)
        self.age = np.zeros(num_envs, np.int64)
        self.total = np.zeros(num_envs)
        self.seed = 0
        self.episode = np.zeros(num_envs, np.int64)
        self.received: list[np.ndarray] = []

    def reset(self, *, seed: Any = None, options: Any = None) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        self.seed = int(seed or 0)
        self.episode[:] = 0
        self._begin(np.ones(self.num_envs, bool))
        return self.observe(), {}

    def step(self, actions: np.ndarray) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        self.received.append(actions.copy())
        turn = np.clip(actions[:, 1], -0.4, 0.4)
        cost = np.clip(actions[:, 0], 0, 1)
        before = np.abs(self.bearing)
        self.bearing = self.bearing - turn
        self.age += 1
        terminated = np.abs(self.bearing) < 0.1
        truncated = (self.age >= self.limit_steps) & ~terminated
        reward = (before - np.abs(self.bearing) - 0.2 * cost + terminated).astype(np.float32)
        self.total += reward
        ended = terminated | truncated
        infos: dict[str, Any] = {"reward_terms": {"turn": before - np.abs(self.bearing), "cost": -0.2 * cost}}
        if ended.any():
            seen = self.observe()
            final = np.full(self.num_envs, None, dtype=object)
            for n in np.flatnonzero(ended):
                final[n] = {name: array[n].copy() for name, array in seen.items()}
            infos |= {"final_obs": final, "_final_obs": ended, "_episode": ended}
            infos["episode"] = {
                "return": self.total.copy(),
                "length": self.age.copy(),
                "success": terminated.copy(),
                "collision": np.zeros(self.num_envs, bool),
                "scenario": np.full(self.num_envs, "random-goal", dtype=object),
            }
            self._begin(ended)
        return self.observe(), reward, terminated, truncated, infos

    def observe(self) -> dict[str, np.ndarray]:
        N = self.num_envs
        seen = {
            "lidar": np.ones((N, 3, RAYS), np.float32),
            "camera": np.zeros((N, *IMAGE), np.uint8),
            "goal": np.stack([np.ones(N), self.bearing], axis=1).astype(np.float32),
            "velocity": np.zeros((N, 2), np.float32),
            "prediction": np.full((N, *IMAGE), 255, np.uint8),
            "worth": np.zeros((N, 25), np.float32),
        }
        if self.people > 0:
            told = np.zeros((N, self.people, 6), np.float32)
            told[:, 0, 0], told[:, 0, 1], told[:, 0, 5] = np.cos(self.bearing), np.sin(self.bearing), 1.0
            seen["people"] = told
        return seen

    def state_dict(self) -> dict[str, np.ndarray]:
        names = ("bearing", "age", "total", "episode")
        return {
            **{name: getattr(self, name).copy() for name in names},
            "seed": np.array(self.seed),
            "names": np.array(["random-goal"] * self.num_envs),
        }

    def load_state_dict(self, state: dict[str, np.ndarray]) -> None:
        for name in ("bearing", "age", "total", "episode"):
            setattr(self, name, np.array(state[name]))
        self.seed = int(state["seed"])
        assert state["names"].tolist() == ["random-goal"] * self.num_envs

    def _begin(self, which: np.ndarray) -> None:
        for n in np.flatnonzero(which):
            rng = np.random.default_rng([self.seed, self.first_world + int(n), int(self.episode[n])])
            self.bearing[n] = rng.uniform(0.5, 2.5) * rng.choice([-1, 1])
        self.episode[which] += 1
        self.age[which] = 0
        self.total[which] = 0.0
