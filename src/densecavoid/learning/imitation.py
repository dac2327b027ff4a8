"""Imitation of a teacher that knows where people truly are (DAgger: Ross, Gordon, Bagnell 2011), as a head start for
PPO. The policy drives more and more by itself, and learns what the teacher would have done where its own driving led.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import torch

from densecavoid.frames import require
from densecavoid.learning.gae import estimate_advantages
from densecavoid.learning.peers import Peers
from densecavoid.learning.ppo import PPOConfig, TrainingDivergedError, learning_rate_of, step, value_loss
from densecavoid.learning.rollout import Rollout, take
from densecavoid.learning.shuffling import minibatches
from densecavoid.policy.network import ActorCritic


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
    _, returns = estimate_advantages(
        rollout.reward,
        rollout.value,
        rollout.next_value,
        rollout.terminated,
        rollout.truncated,
        discount=config.discount,
        trace_decay=config.trace_decay,
    )
    flat_returns, shown = returns.flatten(), rollout.teacher_mean.flatten(0, 1)
    observations, old_values = rollout.flat_observation(), rollout.value.flatten()
    if network.value_moments is not None:
        network.follow_returns(*peers.moments(flat_returns[:, None]))
    unit = 1.0 if network.value_moments is None else network.value_moments.std
    parameters = list(network.parameters())
    totals, gradient_steps = torch.zeros(2, device=shown.device), 0
    for index, size, _ in minibatches(rollout, config.epochs, config.minibatch_size, generator, peers):
        output = network(*take(observations, rollout.people, index))
        apart = ((output.mean - shown[index]) / network.limits).square().mean(dim=1).sum() / size
        wrong = value_loss(output.value / unit, old_values[index] / unit, flat_returns[index] / unit, 0.0).sum() / size
        figures = peers.sum(torch.stack([apart.detach(), wrong.detach()]))
        if not math.isfinite(float(figures.sum())):
            raise TrainingDivergedError(f"the losses of imitation and critic are {figures.tolist()}")
        step(optimiser, weight * apart + config.value_weight * wrong, parameters, config.max_gradient_norm, peers)
        totals += figures
        gradient_steps += 1
    means, std = (totals / gradient_steps).tolist(), network.log_std.detach().exp().tolist()
    return ImitationStatistics(means[0], means[1], gradient_steps, learning_rate_of(optimiser), std[0], std[1])
