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

    def __init__(self, num_envs: int, limit_steps: int = 20, scenario: Any = None) -> None:
        self.num_envs = num_envs
        self.limit_steps = limit_steps
        self.scenario = scenario
        self.single_observation_space = gym.spaces.Dict(
            {
                "lidar": gym.spaces.Box(0, 1, (3, RAYS), np.float32),
                "camera": gym.spaces.Box(0, 255, IMAGE, np.uint8),
                "goal": gym.spaces.Box(-np.inf, np.inf, (2,), np.float32),
                "velocity": gym.spaces.Box(-np.inf, np.inf, (2,), np.float32),
                "prediction": gym.spaces.Box(0, 255, IMAGE, np.uint8),
            }
        )
        self.single_action_space = gym.spaces.Box(np.array([0, -0.4], np.float32), np.array([1, 0.4], np.float32))
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.bearing = np.zeros(num_envs)
        self.age = np.zeros(num_envs, np.int64)
        self.total = np.zeros(num_envs)
        self.rng = np.random.default_rng(0)
        self.received: list[np.ndarray] = []

    def reset(self, *, seed: Any = None, options: Any = None) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        self.rng = np.random.default_rng(seed)
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
        return {
            "lidar": np.ones((N, 3, RAYS), np.float32),
            "camera": np.zeros((N, *IMAGE), np.uint8),
            "goal": np.stack([np.ones(N), self.bearing], axis=1).astype(np.float32),
            "velocity": np.zeros((N, 2), np.float32),
            "prediction": np.full((N, *IMAGE), 255, np.uint8),
        }

    def state_dict(self) -> dict[str, np.ndarray]:
        words = self.rng.bit_generator.state["state"]
        numbers = [(words[name] >> shift) & (2**64 - 1) for name in ("state", "inc") for shift in (0, 64)]
        return {
            "bearing": self.bearing.copy(),
            "age": self.age.copy(),
            "total": self.total.copy(),
            "rng": np.array(numbers, np.uint64),
            "names": np.array(["random-goal"] * self.num_envs),
        }

    def load_state_dict(self, state: dict[str, np.ndarray]) -> None:
        self.bearing, self.age, self.total = (np.array(state[name]) for name in ("bearing", "age", "total"))
        low, high, inc_low, inc_high = (int(word) for word in state["rng"])
        whole = dict(self.rng.bit_generator.state)
        whole["state"] = {"state": low | high << 64, "inc": inc_low | inc_high << 64}
        self.rng.bit_generator.state = whole
        assert state["names"].tolist() == ["random-goal"] * self.num_envs

    def _begin(self, which: np.ndarray) -> None:
        count = int(which.sum())
        self.bearing[which] = self.rng.uniform(0.5, 2.5, count) * self.rng.choice([-1, 1], count)
        self.age[which] = 0
        self.total[which] = 0.0
