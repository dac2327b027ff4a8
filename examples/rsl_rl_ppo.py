"""rsl_rl's PPO on DenseCAvoid's worlds: `python examples/rsl_rl_ppo.py`.

Needs `pip install 'densecavoid[train]' rsl-rl-lib`. Ranges and state go through its layers as they are, the depth image
and the prediction frame through its convolutions.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import numpy as np
import torch
from rsl_rl.env import VecEnv
from rsl_rl.runners import OnPolicyRunner
from tensordict import TensorDict
from torch import Tensor

import densecavoid
from densecavoid.env import DenseCAvoidVectorEnv


class BatchedWorlds(VecEnv):
    """A `DenseCAvoidVectorEnv` as rsl_rl wants it: torch tensors in groups, time limits apart."""

    def __init__(self, worlds: DenseCAvoidVectorEnv, device: str = "cpu") -> None:
        self.worlds = worlds
        self.num_envs, self.num_actions = worlds.num_envs, 2
        self.max_episode_length = 600
        self.episode_length_buf = torch.zeros(worlds.num_envs, dtype=torch.long)
        self.device = device
        self.cfg = {"scenario": worlds.scenario.name}
        self._seen = self._grouped(worlds.reset(seed=0)[0])

    def get_observations(self) -> TensorDict:
        return self._seen

    def step(self, actions: Tensor) -> tuple[TensorDict, Tensor, Tensor, dict]:
        observation, reward, terminated, truncated, infos = self.worlds.step(actions.cpu().numpy())
        self._seen = self._grouped(observation)
        done = torch.from_numpy(terminated | truncated)
        self.episode_length_buf = torch.where(done, 0, self.episode_length_buf + 1)
        late = torch.from_numpy(truncated & ~terminated).float().to(self.device)
        extras: dict = {"time_outs": late}
        if "episode" in infos:
            extras["log"] = {"success": float(np.mean(infos["episode"]["success"][infos["_episode"]]))}
        return self._seen, torch.from_numpy(reward).to(self.device), done.long().to(self.device), extras

    def _grouped(self, observation: dict[str, np.ndarray]) -> TensorDict:
        ranges = np.exp(-4.0 * observation["lidar"]).reshape(self.num_envs, -1)
        numbers = np.concatenate([ranges, observation["goal"], observation["velocity"]], axis=1, dtype=np.float32)
        images = np.stack([observation["camera"], 255 - observation["prediction"]], axis=1) / np.float32(255.0)
        groups = {"numbers": torch.from_numpy(numbers), "images": torch.from_numpy(images)}
        return TensorDict(groups, batch_size=[self.num_envs], device=self.device)


def settings(rollout: int) -> dict:
    """rsl_rl's configuration."""
    model = {
        "class_name": "CNNModel",
        "hidden_dims": [128, 128],
        "activation": "relu",
        "cnn_cfg": {"output_channels": [16, 32], "kernel_size": [5, 3], "stride": [4, 3], "activation": "relu"},
    }
    gaussian = {"class_name": "GaussianDistribution", "init_std": 0.3, "std_type": "log"}
    return {
        "num_steps_per_env": rollout,
        "save_interval": 1_000_000,
        "obs_groups": {"actor": ["numbers", "images"], "critic": ["numbers", "images"]},
        "algorithm": {
            "class_name": "PPO",
            "num_learning_epochs": 4,
            "num_mini_batches": 8,
            "learning_rate": 5e-4,
            "desired_kl": 0.015,
            "entropy_coef": 0.001,
        },
        "actor": {**model, "distribution_cfg": gaussian},
        "critic": dict(model),
    }


def main(args: Sequence[str] | None = None) -> OnPolicyRunner:
    """Trains, and prints what rsl_rl prints."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenario", default="random-goal")
    parser.add_argument("--worlds", type=int, default=64)
    parser.add_argument("--iterations", type=int, default=200)
    parser.add_argument("--rollout", type=int, default=64, help="steps of each world between two updates")
    options = parser.parse_args(args)
    worlds = BatchedWorlds(densecavoid.make_vec(options.scenario, options.worlds))
    runner = OnPolicyRunner(worlds, settings(options.rollout), log_dir=None, device="cpu")
    runner.learn(options.iterations)
    return runner


if __name__ == "__main__":
    main()
