"""Generalised advantage estimation (Schulman et al. 2016, eq. 16) over a batch of worlds. A pure function; a time limit
is not an end of the task and bootstraps from the value of the state in which the clock stopped.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor


class Advantages(NamedTuple):
    """What `estimate_advantages` returns."""

    advantages: Float[Tensor, "T N"]
    returns: Float[Tensor, "T N"]
    """Advantages plus values: the critic's targets (TD(lambda))."""


def estimate_advantages(
    rewards: Float[Tensor, "T N"],
    values: Float[Tensor, "T N"],
    next_values: Float[Tensor, "T N"],
    terminated: Bool[Tensor, "T N"],
    truncated: Bool[Tensor, "T N"],
    *,
    discount: float,
    trace_decay: float,
) -> Advantages:
    """Advantages of T steps in N worlds.

    Args:
        rewards: reward of the transition from state t.
        values: critic's value of state t.
        next_values: critic's value of the state the transition really led to: state t + 1, or the true final state
            where the episode ended there (never the first state of the next episode). Unused where `terminated`.
        terminated: the task ended (goal, collision): nothing follows.
        truncated: the time limit ended the episode: its value is `next_values`. `terminated` wins where both hold.
        discount: gamma, in (0, 1].
        trace_decay: lambda, in [0, 1].
    """
    future = torch.where(terminated, torch.zeros_like(next_values), next_values)
    errors = rewards + discount * future - values
    carries_on = discount * trace_decay * (~(terminated | truncated)).to(rewards.dtype)
    advantages = torch.empty_like(rewards)
    running = torch.zeros_like(rewards[0])
    for t in range(rewards.shape[0] - 1, -1, -1):
        running = errors[t] + carries_on[t] * running
        advantages[t] = running
    return Advantages(advantages, advantages + values)
