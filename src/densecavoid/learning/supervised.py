"""Learning from a rollout in which something better than trying shows what is good: a teacher's commands (`imitation`),
or what commands are worth (`guidance`). The critic learns the returns of who drove, as a head start for PPO.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

from densecavoid.learning.peers import Peers
from densecavoid.learning.ppo import (
    PPOConfig,
    TrainingDivergedError,
    judged,
    learning_rate_of,
    step,
    unit_of_values,
    value_loss,
)
from densecavoid.learning.rollout import Rollout, take
from densecavoid.learning.shuffling import Minibatch, minibatches
from densecavoid.policy.network import ActorCritic, ObservationTensors, PolicyOutput

Lose = Callable[
    [Minibatch, ObservationTensors, Float[Tensor, "n K numbers"] | None], tuple[PolicyOutput, Float[Tensor, "n"]]
]
"""A minibatch, what was seen in it, the true people -> what the network makes of it, and how bad each sample's is."""


def supervise(
    network: ActorCritic,
    optimiser: torch.optim.Adam,
    rollout: Rollout,
    config: PPOConfig,
    epochs: int,
    weight: float,
    lose: Lose,
    generator: torch.Generator,
    peers: Peers,
    what: str,
) -> tuple[float, float, int, float, float, float]:
    """Passes over a rollout, down the gradient of `lose` and of the critic's error.

    Args:
        network, optimiser: changed in place.
        config: of it, discount, minibatches, gradient norm, the critic's weight.
        epochs: number of passes.
        weight: of what `lose` gives.
        generator, peers: as in `ppo.update`.
        what: this is, for errors.

    Returns:
        Means over the minibatches of both losses, how many there were, the learning rate, and the policy's standard
        deviations (m/s, rad/s) in the last.

    Raises:
        TrainingDivergedError, PeerLostError: as `ppo.update`.
    """
    _, returns = judged(rollout, config)
    flat_returns, old_values = returns.flatten(), rollout.value.flatten()
    observations, parameters = rollout.flat_observation(), list(network.parameters())
    unit = unit_of_values(network, flat_returns, peers)
    totals, figures, gradient_steps = torch.zeros(2, device=flat_returns.device), torch.zeros(4), 0
    for batch in minibatches(rollout, epochs, config.minibatch_size, generator, peers):
        index, size, _ = batch
        output, losses = lose(batch, *take(observations, rollout.people, index))
        shown = losses.sum() / size
        wrong = value_loss(output.value / unit, old_values[index] / unit, flat_returns[index] / unit, 0.0).sum() / size
        std = output.policy.std * (len(losses) / size)
        figures = peers.sum(torch.stack([shown, wrong, *std]).detach())
        if not math.isfinite(float(figures.sum())):
            raise TrainingDivergedError(f"the losses of {what} and critic are {figures[:2].tolist()}")
        step(optimiser, weight * shown + config.value_weight * wrong, parameters, config.max_gradient_norm, peers)
        totals += figures[:2]
        gradient_steps += 1
    means = (totals / gradient_steps).tolist()
    return means[0], means[1], gradient_steps, learning_rate_of(optimiser), *figures[2:].tolist()
