"""Stable-Baselines3's PPO on DenseCAvoid's worlds: `python examples/stable_baselines3_ppo.py`.

Needs `pip install 'densecavoid[train]' stable-baselines3`. Any of its algorithms for continuous actions works the same
way. A single world is a plain Gymnasium environment (`make_vec_env("densecavoid/random-goal-v0", n_envs=8)` is enough);
`BatchedWorlds` below hands over all worlds of one simulator at once, which is several times faster.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import VecEnv, VecMonitor
from torch import Tensor, nn

import densecavoid
from densecavoid.env import DenseCAvoidVectorEnv


class BatchedWorlds(VecEnv):
    """A `DenseCAvoidVectorEnv` as Stable-Baselines3 wants it."""

    def __init__(self, worlds: DenseCAvoidVectorEnv) -> None:
        self.worlds = worlds
        self.actions = np.zeros((worlds.num_envs, 2), np.float32)
        self.render_mode = None
        super().__init__(worlds.num_envs, worlds.single_observation_space, worlds.single_action_space)

    def reset(self) -> dict[str, np.ndarray]:
        seed = self._seeds[0]
        self._reset_seeds()
        return self.worlds.reset(seed=seed)[0]

    def step_async(self, actions: np.ndarray) -> None:
        self.actions = actions

    def step_wait(self) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray, list[dict[str, Any]]]:
        observation, reward, terminated, truncated, infos = self.worlds.step(self.actions)
        ended: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for n in np.flatnonzero(terminated | truncated):
            # The observation in which a time limit stopped the clock has a value; SB3 asks for it under this name.
            ended[n] = {
                "terminal_observation": infos["final_obs"][n],
                "TimeLimit.truncated": bool(truncated[n] and not terminated[n]),
                "is_success": bool(infos["episode"]["success"][n]),
                "scenario": str(infos["episode"]["scenario"][n]),
            }
        return observation, reward, terminated | truncated, ended

    def close(self) -> None:
        self.worlds.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        return [getattr(self.worlds, attr_name, None)] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        setattr(self.worlds, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        return [getattr(self.worlds, method_name)(*args, **kwargs)]

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        return [False] * self.num_envs


class Branches(BaseFeaturesExtractor):
    """The branches of the `compact` network in torch's own layers: 261 features for the two heads of 128."""

    def __init__(self, observation_space: Any) -> None:
        super().__init__(observation_space, features_dim=128 + 128 + 5)
        self.lidar = nn.Sequential(
            *(nn.Conv1d(3, 32, 8, 8), nn.ReLU(), nn.Conv1d(32, 32, 2, 2), nn.ReLU(), nn.Flatten()),
            *(nn.Linear(1024, 128), nn.ReLU()),
        )
        self.camera = nn.Sequential(
            *(nn.Conv2d(2, 16, 4, 4), nn.ReLU(), nn.Conv2d(16, 32, (3, 4), (3, 4)), nn.ReLU(), nn.Flatten()),
            *(nn.Linear(800, 128), nn.ReLU()),
        )

    def forward(self, seen: dict[str, Tensor]) -> Tensor:
        images = torch.stack([seen["camera"], 255.0 - seen["prediction"]], dim=1) / 255.0
        distance, bearing = (seen["goal"][:, :1] / 5.0).clamp(max=4.0), seen["goal"][:, 1:]
        velocity = seen["velocity"] / torch.tensor([1.0, 0.4], device=bearing.device)
        state = 2.0 * torch.cat([distance, bearing.cos(), bearing.sin(), velocity], dim=1)
        return torch.cat([self.lidar(torch.exp(-4.0 * seen["lidar"])), self.camera(images), state], dim=1)


def make_ppo(worlds: VecEnv, **settings: Any) -> PPO:
    """PPO with that network; `settings` are PPO's."""
    network = {
        "features_extractor_class": Branches,
        "net_arch": {"pi": [128], "vf": [128]},
        "activation_fn": nn.ReLU,
        "normalize_images": False,
        "log_std_init": -1.0,
    }
    return PPO("MultiInputPolicy", worlds, policy_kwargs=network, **settings)


def main(args: Sequence[str] | None = None) -> PPO:
    """Trains, and prints what Stable-Baselines3 prints."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenario", default="random-goal")
    parser.add_argument("--worlds", type=int, default=64)
    parser.add_argument("--steps", type=int, default=500_000)
    parser.add_argument("--rollout", type=int, default=64, help="steps of each world between two updates")
    options = parser.parse_args(args)
    worlds = VecMonitor(BatchedWorlds(densecavoid.make_vec(options.scenario, options.worlds)))
    ppo = make_ppo(
        worlds,
        n_steps=options.rollout,
        batch_size=512,
        n_epochs=4,
        learning_rate=5e-4,
        target_kl=0.03,
        verbose=1,
        seed=0,
    )
    return ppo.learn(options.steps)


if __name__ == "__main__":
    main()
