"""What each process of a training does in the tests of several processes: `torchrun one_of_many.py WHAT FOLDER`."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

import numpy as np
import torch
from fake_env import PointEnv
from rich.console import Console
from small_network import TINY

from densecavoid.learning import run as run_module
from densecavoid.learning.checkpoint import save_checkpoint
from densecavoid.learning.config import TrainConfig
from densecavoid.learning.curriculum import CurriculumConfig
from densecavoid.learning.peers import PeerLostError, join_peers
from densecavoid.learning.ppo import PPOConfig
from densecavoid.learning.trainer import Trainer
from densecavoid.policy.network import PRESETS
from densecavoid.sim.spec import Scenario

WORLDS, STEPS, ITERATIONS = 12, 16, 6


def settings(run_dir: Path, processes: int, **changes: Any) -> TrainConfig:
    """As many worlds in all, whatever the number of processes."""
    return TrainConfig(
        run_dir=run_dir,
        num_envs=WORLDS // processes,
        steps_per_rollout=STEPS,
        total_steps=ITERATIONS * WORLDS * STEPS,
        threads=1,
        precision="float32",
        checkpoint_every=1,
        normalise_inputs=True,
        normalise_values=True,
        privileged_critic=True,
        noise_persistence=0.5,
        ppo=PPOConfig(mirror=True, minibatch_size=64, learning_rate=5e-4, target_kl=0.01),
        curriculum=CurriculumConfig(window=3, threshold=0.6, level_step=0.5),
        **changes,
    )


def make_envs(config: TrainConfig, scenario: Scenario, first_world: int) -> list[PointEnv]:
    size = config.num_envs // config.num_groups
    return [
        PointEnv(size, scenario=scenario, first_world=first, people=8)
        for first in range(first_world, first_world + config.num_envs, size)
    ]


def learn(config: TrainConfig) -> tuple[Trainer, list[dict[str, Any]]]:
    """The whole training without its folder."""
    PRESETS["compact"] = TINY
    with join_peers(torch.device("cpu"), timeout_s=60) as peers:
        trainer = Trainer(config, make_envs, peers)
        records = [trainer.iterate() for _ in range(ITERATIONS)]
        save_checkpoint(config.run_dir / f"state-{peers.rank}-of-{peers.count}", trainer.state_dict())
    return trainer, records


class Mortal(PointEnv):
    """Its process ends without a word in the middle of the third rollout."""

    def step(self, actions: np.ndarray) -> Any:
        if len(self.received) == 2 * STEPS + 5:
            os._exit(3)
        return super().step(actions)


def lose_a_process(config: TrainConfig) -> None:
    """A run whose second process dies."""
    PRESETS["compact"] = TINY
    run_module.export_onnx = lambda path, network, card: None
    kind = Mortal if os.environ["RANK"] == "1" else PointEnv

    def mortals(config: TrainConfig, scenario: Scenario, first_world: int) -> list[PointEnv]:
        return [kind(config.num_envs, scenario=scenario, first_world=first_world, people=8)]

    try:
        run_module.train(config, make_envs=mortals, console=Console(stderr=True))
    except PeerLostError as error:
        print(error, file=sys.stderr, flush=True)
        sys.exit(1)


if __name__ == "__main__":
    what, folder = sys.argv[1], Path(sys.argv[2])
    torch.set_num_threads(1)
    if what == "learn":
        learn(settings(folder, int(os.environ["WORLD_SIZE"])))
    else:
        lose_a_process(settings(folder, int(os.environ["WORLD_SIZE"])))
