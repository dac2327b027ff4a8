"""Imitation of a teacher that knows where people truly are (DAgger: Ross, Gordon, Bagnell 2011), as a head start for
PPO. The policy drives more and more by itself, and learns what the teacher would have done where its own driving led.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from densecavoid.frames import require
from densecavoid.learning.peers import Peers
from densecavoid.learning.ppo import PPOConfig
from densecavoid.learning.rollout import Rollout
from densecavoid.learning.shuffling import Minibatch
from densecavoid.learning.supervised import supervise
from densecavoid.policy.network import ActorCritic, ObservationTensors, PolicyOutput


@dataclass(frozen=True)
class ImitationConfig:
    """A teacher to learn from before PPO begins; off unless one is given."""

    teacher: Path | None = None
    """Policy (.safetensors) of a privileged teacher, such as `--network teacher` trains."""
    steps: int = 500_000
    """Environment steps for which it is imitated."""
    drives: float = 0.5
    """Share of the steps in which the teacher drives, at the start; sinks to 0 half way through."""
    weight: float = 10.0
    """Of the distance to the teacher beside the critic's loss, whose gradient would otherwise drown it."""

    def __post_init__(self) -> None:
        require(self.steps > 0, "ImitationConfig.steps", self.steps, "positive")
        require(self.weight > 0, "ImitationConfig.weight", self.weight, "positive")
        require(0 <= self.drives <= 1, "ImitationConfig.drives", self.drives, "in [0, 1]")

    def share(self, steps_done: int) -> float:
        """Share of the steps in which the teacher drives, after so many environment steps."""
        return self.drives * max(0.0, 1.0 - 2.0 * steps_done / self.steps)


@dataclass(frozen=True)
class ImitationStatistics:
    """What happened in one update; means over its minibatches."""

    imitation_loss: float
    """Mean squared distance to the teacher's command, as a share of the robot's limits."""
    value_loss: float
    gradient_steps: int
    learning_rate: float
    std_linear: float
    """m/s"""
    std_angular: float
    """rad/s"""


def imitate(
    network: ActorCritic,
    optimiser: torch.optim.Adam,
    rollout: Rollout,
    config: PPOConfig,
    weight: float,
    generator: torch.Generator,
    peers: Peers = Peers(),  # noqa: B008
) -> ImitationStatistics:
    """Moves the policy's mean towards the teacher's and the critic towards the returns of who drove.

    Args:
        network: changed in place.
        optimiser: over the network's parameters.
        rollout: collected with a teacher.
        config: of it, what is not PPO's alone: discount, passes, minibatches, gradient norm, the critic's weight.
        weight: of the distance to the teacher.
        generator: as in `ppo.update`.
        peers: as in `ppo.update`.

    Raises:
        TrainingDivergedError, PeerLostError: as `ppo.update`.
    """
    require(rollout.teacher_mean is not None, "Rollout.teacher_mean", None, "a rollout collected with a teacher")
    assert rollout.teacher_mean is not None
    shown = rollout.teacher_mean.flatten(0, 1)

    def apart(
        batch: Minibatch, seen: ObservationTensors, people: Tensor | None
    ) -> tuple[PolicyOutput, Float[Tensor, "n"]]:
        output = network(seen, people)
        return output, ((output.policy.mode - shown[batch.own]) / network.limits).square().mean(dim=1)

    return ImitationStatistics(
        *supervise(network, optimiser, rollout, config, config.epochs, weight, apart, generator, peers, "imitation")
    )
