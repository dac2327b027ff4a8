"""Proximal policy optimisation (Schulman et al. 2017): one update from one rollout, read from top to bottom. It neither
collects nor logs. Several processes that each hold a part of the worlds do together exactly what one would do that
holds them all.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor, nn

from densecavoid.frames import choose, require
from densecavoid.learning.gae import estimate_advantages
from densecavoid.learning.mirror import mirror_action, mirror_observation, mirror_people
from densecavoid.learning.peers import Peers
from densecavoid.learning.rollout import Rollout, take
from densecavoid.learning.shuffling import minibatches
from densecavoid.policy.network import ActorCritic

LEARNING_RATE_SCHEDULES = ("fixed", "linear", "adaptive")


@dataclass(frozen=True)
class PPOConfig:
    """The update's settings. The paper gives none: they follow its group's neighbouring code or were measured here."""

    discount: float = 0.99
    """Gamma, a step of .1 s."""
    trace_decay: float = 0.95
    """Lambda of generalised advantage estimation."""
    reward_scale: float = 0.05
    """Rewards are multiplied by it, so that returns are of order one (1/20: halves the steps to a first policy)."""
    epochs: int = 4
    """Passes over each rollout."""
    minibatch_size: int = 512
    """Samples a gradient step, over all processes. Many small steps learn several times faster than few large ones."""
    clip: float = 0.2
    """The probability ratio is clipped to 1 +- this."""
    value_clip: float = 0.0
    """The value may move this far from the rollout's before its loss is cut (scaled reward); 0 = no clipping."""
    value_weight: float = 0.5
    """Weight of the critic's loss."""
    entropy_weight: float = 0.001
    """Weight of the entropy bonus."""
    normalise_advantages: Literal["minibatch", "rollout", "never"] = "minibatch"
    """Over what advantages are brought to mean 0 and variance 1."""
    target_kl: float = 0.03
    """The update stops when a minibatch's KL divergence from the rollout's policy passes 1.5 times this; 0 = never."""
    max_gradient_norm: float = 0.5
    """Gradients are scaled down to this norm."""
    learning_rate: float = 5e-4
    """Adam's, at the start."""
    mirror: bool = False
    """Learn from half of the samples, the other half in the next pass, with left and right exchanged."""
    schedule: Literal["fixed", "linear", "adaptive"] = "adaptive"
    """`fixed`, `linear` (to zero at the last step) or `adaptive` (keeps each update's KL near half of target_kl)."""

    def __post_init__(self) -> None:
        require(0 < self.discount <= 1, "PPOConfig.discount", self.discount, "in (0, 1]")
        require(0 <= self.trace_decay <= 1, "PPOConfig.trace_decay", self.trace_decay, "in [0, 1]")
        for name in ("reward_scale", "epochs", "minibatch_size", "clip", "max_gradient_norm", "learning_rate"):
            require(getattr(self, name) > 0, f"PPOConfig.{name}", getattr(self, name), "positive")
        for name in ("value_clip", "value_weight", "entropy_weight", "target_kl"):
            require(getattr(self, name) >= 0, f"PPOConfig.{name}", getattr(self, name), "0 or more")
        choose("PPOConfig.normalise_advantages", self.normalise_advantages, ("minibatch", "rollout", "never"))
        choose("learning-rate schedule", self.schedule, LEARNING_RATE_SCHEDULES)
        require(
            self.schedule != "adaptive" or self.target_kl > 0,
            "PPOConfig.target_kl",
            self.target_kl,
            "positive with schedule 'adaptive'",
        )


class TrainingDivergedError(RuntimeError):
    """A loss or a gradient is not finite; the network has not been stepped with it."""


@dataclass(frozen=True)
class UpdateStatistics:
    """What happened in one update; means over its minibatches."""

    policy_loss: float
    value_loss: float
    entropy: float
    kl: float
    """Estimate of the KL divergence from the rollout's policy, mean of (r - 1) - log r."""
    clip_fraction: float
    gradient_norm: float
    explained_variance: float
    first_ratio_error: float
    """Greatest |ratio - 1| of the first minibatch: rounding, or the log-probabilities are another policy's."""
    gradient_steps: int
    stopped_early: bool
    learning_rate: float
    std_linear: float
    """m/s, in the last minibatch"""
    std_angular: float
    """rad/s"""


def make_optimiser(network: ActorCritic, config: PPOConfig) -> torch.optim.Adam:
    """Adam over all of the network's parameters."""
    return torch.optim.Adam(network.parameters(), lr=config.learning_rate, eps=1e-5, fused=True)


def policy_loss(
    log_prob: Float[Tensor, "B"], old_log_prob: Float[Tensor, "B"], advantage: Float[Tensor, "B"], clip: float
) -> tuple[Float[Tensor, "B"], Float[Tensor, "B"]]:
    """The clipped surrogate of each sample (eq. 7), negated to be minimised, and the probability ratios."""
    ratio = (log_prob - old_log_prob).exp()
    return -torch.minimum(ratio * advantage, ratio.clamp(1.0 - clip, 1.0 + clip) * advantage), ratio


def value_loss(
    value: Float[Tensor, "B"], old_value: Float[Tensor, "B"], returns: Float[Tensor, "B"], clip: float
) -> Float[Tensor, "B"]:
    """Half the squared error; with `clip` > 0, each sample's worse of it and that of a value kept near the old one."""
    squared = (value - returns).square()
    if clip > 0:
        kept = old_value + (value - old_value).clamp(-clip, clip)
        squared = torch.maximum(squared, (kept - returns).square())
    return 0.5 * squared


def update(
    network: ActorCritic,
    optimiser: torch.optim.Adam,
    rollout: Rollout,
    config: PPOConfig,
    generator: torch.Generator,
    progress: float = 0.0,
    peers: Peers = Peers(),  # noqa: B008
) -> UpdateStatistics:
    """Improves the network on one rollout.

    Args:
        network: changed in place.
        optimiser: over the network's parameters; its learning rate is set by the schedule.
        rollout: collected with this very network.
        config: settings.
        generator: source of the shuffling, on the network's device, in the same state in all processes.
        progress: share of the training that is done, in [0, 1], for the linear schedule.
        peers: the processes that hold the other worlds' rollouts.

    Raises:
        TrainingDivergedError: if a loss or a gradient is not finite; the step that would have used it is not taken.
        PeerLostError: if another process is gone.
    """
    advantages, returns = judged(rollout, config)
    observations = rollout.flat_observation()
    actions = rollout.action.flatten(0, 1)
    old_log_probs, old_values = rollout.log_prob.flatten(), rollout.value.flatten()
    flat_advantages, flat_returns = advantages.flatten(), returns.flatten()
    explained = explained_variance(old_values, flat_returns, peers)
    if config.normalise_advantages == "rollout":
        flat_advantages = _normalised(flat_advantages, peers)
    unit = unit_of_values(network, flat_returns, peers)
    if config.schedule == "linear":
        set_learning_rate(optimiser, config.learning_rate * max(0.0, 1.0 - progress))

    parameters = list(network.parameters())
    totals, last_std = torch.zeros(5, device=actions.device), [math.nan, math.nan]
    gradient_steps, stopped, kl, first_ratio_error = 0, False, 0.0, 0.0
    for index, size, other_half in minibatches(rollout, config.epochs, config.minibatch_size, generator, peers):
        advantage = flat_advantages[index]
        if config.normalise_advantages == "minibatch":
            advantage = _normalised(advantage, peers)
        (seen, people), done = take(observations, rollout.people, index), actions[index]
        as_it_was = torch.ones_like(other_half)
        if config.mirror:
            # What was done has the same probability in the mirror, under the policy in the mirror that did it.
            seen, done, as_it_was = mirror_observation(seen, other_half), mirror_action(done, other_half), ~other_half
            people = None if people is None else mirror_people(people, other_half)
        output = network(seen, people)
        policy = output.policy
        losses_policy, ratio = policy_loss(policy.log_prob(done), old_log_probs[index], advantage, config.clip)
        losses_value = value_loss(
            output.value / unit, old_values[index] / unit, flat_returns[index] / unit, config.value_clip
        )
        # Means over the minibatch of all processes: their gradients add up to the one of a single process.
        loss_policy, loss_value = losses_policy.sum() / size, losses_value.sum() / size
        entropy = policy.entropy() * (len(done) / size)
        loss = loss_policy + config.value_weight * loss_value - config.entropy_weight * entropy

        with torch.no_grad():
            kept = ratio[as_it_was]
            away = (kept - 1.0).abs()
            sums = [(kept - 1.0 - kept.log()).sum(), (away > config.clip).sum(), as_it_was.sum()]
            std = policy.std * (len(done) / size)
            means = [loss_policy, loss_value, loss, entropy, *std]
            figures = peers.sum(torch.stack([*means, *(each.float() for each in sums)]))
            figures[6:8] /= figures[8].clamp(min=1.0)
            if gradient_steps == 0 and len(away) > 0:
                first_ratio_error = float(away.max())
        of_policy, of_value, total, _, *last_std, kl, _, _ = figures.tolist()
        if not math.isfinite(total):
            raise TrainingDivergedError(
                f"the loss is {total} (policy {of_policy}, value {of_value}, KL {kl}) at gradient step "
                f"{gradient_steps} of the update"
            )
        if config.target_kl > 0 and kl > 1.5 * config.target_kl:
            stopped = True
            break

        norm = step(optimiser, loss, parameters, config.max_gradient_norm, peers)
        network.raise_std_to_floor()
        gradient_steps += 1
        totals += torch.stack([figures[0], figures[1], figures[3], figures[7], norm])

    if config.schedule == "adaptive":
        set_learning_rate(optimiser, adapted_learning_rate(learning_rate_of(optimiser), kl, config.target_kl))
    means = (totals / max(1, gradient_steps)).tolist()
    return UpdateStatistics(
        policy_loss=means[0],
        value_loss=means[1],
        entropy=means[2],
        kl=kl,
        clip_fraction=means[3],
        gradient_norm=means[4],
        explained_variance=explained,
        first_ratio_error=first_ratio_error,
        gradient_steps=gradient_steps,
        stopped_early=stopped,
        learning_rate=learning_rate_of(optimiser),
        std_linear=last_std[0],
        std_angular=last_std[1],
    )


def judged(rollout: Rollout, config: PPOConfig) -> tuple[Float[Tensor, "T N"], Float[Tensor, "T N"]]:
    """Advantages and returns of a rollout's steps."""
    return estimate_advantages(
        rollout.reward,
        rollout.value,
        rollout.next_value,
        rollout.terminated,
        rollout.truncated,
        discount=config.discount,
        trace_decay=config.trace_decay,
    )


def unit_of_values(network: ActorCritic, returns: Float[Tensor, "N"], peers: Peers) -> Tensor | float:
    """What the critic's errors are measured in: 1, or the returns' standard deviation where it is normalised, which
    takes these returns in first.
    """
    if network.value_moments is None:
        return 1.0
    network.follow_returns(*peers.moments(returns[:, None]))
    return network.value_moments.std


def step(
    optimiser: torch.optim.Adam, loss: Tensor, parameters: list[nn.Parameter], max_norm: float, peers: Peers
) -> Float[Tensor, ""]:
    """One step down the gradient of the processes' summed losses; returns the gradient's norm before it was cut.

    Raises:
        TrainingDivergedError: if the norm is not finite; the step is not taken.
    """
    optimiser.zero_grad(set_to_none=True)
    loss.backward()
    peers.sum_gradients(parameters)
    norm = nn.utils.clip_grad_norm_(parameters, max_norm)
    if not math.isfinite(float(norm)):
        raise TrainingDivergedError(f"the gradient's norm is {float(norm)}; the step was not taken")
    optimiser.step()
    return norm.detach()


def follow_inputs(network: ActorCritic, rollout: Rollout, peers: Peers = Peers()) -> None:  # noqa: B008
    """Takes a rollout into the running moments of the inputs, where the network keeps any. After its update: within
    one, the network must see what it saw when it acted.
    """
    if network.range_moments is None or network.state_moments is None:
        return
    with torch.no_grad():
        ranges, state = network.raw_numbers(rollout.flat_observation())
        network.range_moments.merge(*peers.moments(ranges.flatten(0, 1)))
        network.state_moments.merge(*peers.moments(state))


def explained_variance(
    value: Float[Tensor, "N"],
    returns: Float[Tensor, "N"],
    peers: Peers = Peers(),  # noqa: B008
) -> float:
    """1 - Var(returns - value) / Var(returns): 1 is a perfect critic, 0 one that knows only the mean."""
    _, _, variance = peers.moments(torch.stack([returns, returns - value], dim=1))
    return float(1.0 - variance[1] / variance[0]) if variance[0] > 0 else float("nan")


def _normalised(advantage: Float[Tensor, "N"], peers: Peers) -> Float[Tensor, "N"]:
    _, mean, variance = peers.moments(advantage[:, None])
    return (advantage - mean) / (variance.sqrt() + 1e-8)


def adapted_learning_rate(rate: float, kl: float, target_kl: float) -> float:
    """A third less after a large step, half as much again after a small one (as rsl_rl does), within [1e-5, 1e-3]."""
    if kl > target_kl:
        return max(1e-5, rate / 1.5)
    if kl < 0.25 * target_kl:
        return min(1e-3, rate * 1.5)
    return rate


def learning_rate_of(optimiser: torch.optim.Adam) -> float:
    """The rate in use."""
    return float(optimiser.param_groups[0]["lr"])


def set_learning_rate(optimiser: torch.optim.Adam, rate: float) -> None:
    """Of all parameters."""
    for group in optimiser.param_groups:
        group["lr"] = rate
