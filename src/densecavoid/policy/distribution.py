"""The policy's distribution: a diagonal Gaussian over (v, w) around the squashed mean. It is not truncated; the
environment clips what it executes, and the log-probability is that of the unclipped sample.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

_HALF_LOG_TWO_PI = 0.5 * math.log(2.0 * math.pi)


class DiagonalGaussian(NamedTuple):
    """Independent normal distributions of linear (m/s) and angular (rad/s) velocity."""

    mean: Float[Tensor, "B 2"]
    log_std: Float[Tensor, "2"]
    """Natural logarithm of the standard deviations, the same in every state."""

    def at(self, noise: Float[Tensor, "B 2"]) -> Float[Tensor, "B 2"]:
        """The draw that standard normal `noise` stands for."""
        return self.mean + noise * self.log_std.exp()

    def log_prob(self, action: Float[Tensor, "B 2"]) -> Float[Tensor, "B"]:
        """Natural logarithm of the density at `action`."""
        standardised = (action - self.mean) * torch.exp(-self.log_std)
        return (-0.5 * standardised.square() - self.log_std - _HALF_LOG_TWO_PI).sum(dim=1)

    def entropy(self) -> Float[Tensor, ""]:
        """Differential entropy in nats; the same in every state."""
        return (self.log_std + 0.5 + _HALF_LOG_TWO_PI).sum()
