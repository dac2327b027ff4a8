"""Learning directly from what every command is worth (`foreseen_envs`), as a head start for PPO.

The policy drives; wherever that leads, it is made likelier to do what is worth much there, over all commands at once
and not only the one that it tried (Ross and Bagnell 2014, AggreVaTe; Sun et al. 2017). What commands are worth supposes
that the future is known from the next moment on: to wait and see never costs much. PPO then learns what really follows.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from densecavoid.frames import require
from densecavoid.learning.mirror import mirror_action, mirror_observation, mirror_people
from densecavoid.learning.peers import Peers
from densecavoid.learning.ppo import PPOConfig
from densecavoid.learning.rollout import Rollout
from densecavoid.learning.shuffling import Minibatch
from densecavoid.learning.supervised import supervise
from densecavoid.policy.network import ActorCritic, ObservationTensors, PolicyOutput


@dataclass(frozen=True)
class GuidanceStatistics:
    """What happened in one update; means over its minibatches."""

    regret: float
    """What the policy's commands lose (`losses_of_commands`), and how unsteady they are."""
    value_loss: float
    gradient_steps: int
    learning_rate: float
    std_linear: float
    """m/s"""
    std_angular: float
    """rad/s"""


def losses_of_commands(values: Float[Tensor, "B C"], serious: float, evenness: float) -> Float[Tensor, "B C"]:
    """How much worse than the best each command is, as a share of what is at stake there: 0 to nearly 1.

    Args:
        values: what each command is worth.
        serious: what is worse than the best by this much or more is equally bad. Without a limit a collision would
            count so much more than anything else that to dither before a narrow way would not matter.
        evenness: added to what is at stake: where all commands are worth the same, none is bad.
    """
    lost = (values.amax(dim=1, keepdim=True) - values).clamp(max=serious)
    return lost / (evenness + lost.amax(dim=1, keepdim=True))


def guide(
    network: ActorCritic,
    optimiser: torch.optim.Adam,
    rollout: Rollout,
    commands: Float[Tensor, "C 2"],
    epochs: int,
    serious: float,
    evenness: float,
    steadiness: float,
    weight: float,
    config: PPOConfig,
    generator: torch.Generator,
    peers: Peers = Peers(),  # noqa: B008
) -> GuidanceStatistics:
    """Makes the policy likelier to do what is worth more, and moves the critic towards the returns.

    Args:
        network: changed in place; the standard deviation of a Gaussian policy stays.
        optimiser: over the network's parameters.
        rollout: collected in worlds that tell what `commands` are worth.
        commands: the grid of the rollout's `command_values`.
        epochs: passes over the rollout.
        serious, evenness: as in `losses_of_commands`.
        steadiness: what it counts to turn at full speed one way when the robot turns so the other way. Where both ways
            are as good, the policy goes on as it began instead of dithering.
        weight: of what the policy loses, beside the critic's error; with 0 the critic alone learns.
        config: of it, the critic's settings, minibatches and gradient norm.
        generator, peers: as in `ppo.update`.

    Raises:
        TrainingDivergedError, PeerLostError: as `ppo.update`.
    """
    require(rollout.command_values is not None, "Rollout.command_values", None, "a rollout in foreseen worlds")
    assert rollout.command_values is not None
    worth = rollout.command_values.flatten(0, 1)
    everything = torch.ones(len(commands), dtype=torch.bool, device=commands.device)
    mirrored = mirror_action(commands, everything)

    def regret(
        batch: Minibatch, seen: ObservationTensors, people: Tensor | None
    ) -> tuple[PolicyOutput, Float[Tensor, "n"]]:
        # Left and right are exchanged in what is seen of half of them, and so in what their values are of.
        other_half = batch.other_half
        grid = torch.where(other_half[:, None, None], mirrored, commands)
        people = None if people is None else mirror_people(people, other_half)
        seen = mirror_observation(seen, other_half)
        output = network(seen, people)
        losses = losses_of_commands(worth[batch.own], serious, evenness)
        changed = (grid[..., 1] - seen.velocity[:, None, 1]).abs() / (commands[:, 1].max() - commands[:, 1].min())
        return output, (output.policy.shares(grid) * (losses + steadiness * changed)).sum(dim=1)

    return GuidanceStatistics(
        *supervise(network, optimiser, rollout, config, epochs, weight, regret, generator, peers, "guidance")
    )
