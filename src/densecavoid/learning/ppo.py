"""Proximal policy optimisation (Schulman et al. 2017): one update from one rollout, read from top to bottom. It neither
collects nor logs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn

from densecavoid.frames import choose, require
from densecavoid.learning.gae import estimate_advantages
from densecavoid.learning.rollout import Rollout, explained_variance
from densecavoid.policy.distribution import DiagonalGaussian
from densecavoid.policy.network import ActorCritic, ObservationTensors

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
    """Samples a gradient step. Many small steps learn several times faster than few large ones."""
    clip: float = 0.2
    """The probability ratio is clipped to 1 +- this."""
    value_clip: float = 0.0
    """The value may move this far from the rollout's before its loss is cut (scaled reward); 0 = no clipping."""
    value_weight: float = 0.5
    """Weight of the critic's loss."""
    entropy_weight: float = 0.001
    """Weight of the entropy bonus."""
    target_kl: float = 0.03
    """The update stops when a minibatch's KL divergence from the rollout's policy passes 1.5 times this; 0 = never."""
    max_gradient_norm: float = 0.5
    """Gradients are scaled down to this norm."""
    learning_rate: float = 5e-4
    """Adam's, at the start."""
    schedule: str = "adaptive"
    """`fixed`, `linear` (to zero at the last step) or `adaptive` (keeps each update's KL near half of target_kl)."""

    def __post_init__(self) -> None:
        require(0 < self.discount <= 1, "PPOConfig.discount", self.discount, "in (0, 1]")
        require(0 <= self.trace_decay <= 1, "PPOConfig.trace_decay", self.trace_decay, "in [0, 1]")
        for name in ("reward_scale", "epochs", "minibatch_size", "clip", "max_gradient_norm", "learning_rate"):
            require(getattr(self, name) > 0, f"PPOConfig.{name}", getattr(self, name), "positive")
        for name in ("value_clip", "value_weight", "entropy_weight", "target_kl"):
            require(getattr(self, name) >= 0, f"PPOConfig.{name}", getattr(self, name), "0 or more")
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
    """m/s"""
    std_angular: float
    """rad/s"""


def make_optimiser(network: ActorCritic, config: PPOConfig) -> torch.optim.Adam:
    """Adam over all of the network's parameters."""
    return torch.optim.Adam(network.parameters(), lr=config.learning_rate, eps=1e-5, fused=True)


def policy_loss(
    log_prob: Float[Tensor, "B"], old_log_prob: Float[Tensor, "B"], advantage: Float[Tensor, "B"], clip: float
) -> tuple[Float[Tensor, ""], Float[Tensor, "B"]]:
    """The clipped surrogate (eq. 7), negated to be minimised, and the probability ratios."""
    ratio = (log_prob - old_log_prob).exp()
    surrogate = torch.minimum(ratio * advantage, ratio.clamp(1.0 - clip, 1.0 + clip) * advantage)
    return -surrogate.mean(), ratio


def value_loss(
    value: Float[Tensor, "B"], old_value: Float[Tensor, "B"], returns: Float[Tensor, "B"], clip: float
) -> Float[Tensor, ""]:
    """Half the mean squared error; with `clip` > 0, each sample's worse of it and that of a value kept near the old."""
    squared = (value - returns).square()
    if clip > 0:
        kept = old_value + (value - old_value).clamp(-clip, clip)
        squared = torch.maximum(squared, (kept - returns).square())
    return 0.5 * squared.mean()


def update(
    network: ActorCritic,
    optimiser: torch.optim.Adam,
    rollout: Rollout,
    config: PPOConfig,
    generator: torch.Generator,
    progress: float = 0.0,
) -> UpdateStatistics:
    """Improves the network on one rollout.

    Args:
        network: changed in place.
        optimiser: over the network's parameters; its learning rate is set by the schedule.
        rollout: collected with this very network.
        config: settings.
        generator: source of the shuffling, on the network's device.
        progress: share of the training that is done, in [0, 1], for the linear schedule.

    Raises:
        TrainingDivergedError: if a loss or a gradient is not finite; the step that would have used it is not taken.
    """
    advantages, returns = estimate_advantages(
        rollout.reward,
        rollout.value,
        rollout.next_value,
        rollout.terminated,
        rollout.truncated,
        discount=config.discount,
        trace_decay=config.trace_decay,
    )
    observations = ObservationTensors(*(stored.flatten(0, 1) for stored in rollout.observation))
    actions = rollout.action.flatten(0, 1)
    old_log_probs, old_values = rollout.log_prob.flatten(), rollout.value.flatten()
    flat_advantages, flat_returns = advantages.flatten(), returns.flatten()
    if config.schedule == "linear":
        _set_learning_rate(optimiser, config.learning_rate * max(0.0, 1.0 - progress))

    samples = actions.shape[0]
    num_minibatches = max(1, round(samples / config.minibatch_size))
    totals = torch.zeros(5, device=actions.device)
    gradient_steps, stopped, kl, first_ratio_error = 0, False, 0.0, 0.0
    for _ in range(config.epochs):
        order = torch.randperm(samples, generator=generator, device=actions.device)
        for index in order.tensor_split(num_minibatches):
            batch = ObservationTensors(*(tensor.index_select(0, index) for tensor in observations))
            advantage = flat_advantages[index]
            advantage = (advantage - advantage.mean()) / (advantage.std(correction=0) + 1e-8)

            output = network(batch)
            policy = DiagonalGaussian(output.mean, network.log_std)
            loss_policy, ratio = policy_loss(
                policy.log_prob(actions[index]), old_log_probs[index], advantage, config.clip
            )
            loss_value = value_loss(output.value, old_values[index], flat_returns[index], config.value_clip)
            entropy = policy.entropy()
            loss = loss_policy + config.value_weight * loss_value - config.entropy_weight * entropy

            with torch.no_grad():
                kl = float((ratio - 1.0 - ratio.log()).mean())
                clipped = ((ratio - 1.0).abs() > config.clip).float().mean()
                if gradient_steps == 0:
                    first_ratio_error = float((ratio - 1.0).abs().max())
            if not math.isfinite(float(loss.detach())):
                raise TrainingDivergedError(
                    f"the loss is {float(loss.detach())} (policy {float(loss_policy.detach())}, value "
                    f"{float(loss_value.detach())}, KL {kl}) at gradient step {gradient_steps} of the update"
                )
            if config.target_kl > 0 and kl > 1.5 * config.target_kl:
                stopped = True
                break

            optimiser.zero_grad(set_to_none=True)
            loss.backward()
            norm = nn.utils.clip_grad_norm_(network.parameters(), config.max_gradient_norm)
            if not math.isfinite(float(norm)):
                raise TrainingDivergedError(f"the gradient's norm is {float(norm)} at gradient step {gradient_steps}")
            optimiser.step()
            network.raise_std_to_floor()
            gradient_steps += 1
            totals += torch.stack([loss_policy.detach(), loss_value.detach(), entropy.detach(), clipped, norm])
        if stopped:
            break

    if config.schedule == "adaptive":
        _set_learning_rate(optimiser, adapted_learning_rate(learning_rate_of(optimiser), kl, config.target_kl))
    means = (totals / max(1, gradient_steps)).tolist()
    std = network.log_std.detach().exp().tolist()
    return UpdateStatistics(
        policy_loss=means[0],
        value_loss=means[1],
        entropy=means[2],
        kl=kl,
        clip_fraction=means[3],
        gradient_norm=means[4],
        explained_variance=explained_variance(rollout.value, returns),
        first_ratio_error=first_ratio_error,
        gradient_steps=gradient_steps,
        stopped_early=stopped,
        learning_rate=learning_rate_of(optimiser),
        std_linear=std[0],
        std_angular=std[1],
    )


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


def _set_learning_rate(optimiser: torch.optim.Adam, rate: float) -> None:
    for group in optimiser.param_groups:
        group["lr"] = rate
