"""The policy's distributions over commands (v m/s, w rad/s): the paper's Gaussian around a mean, and probabilities of
the commands of a grid. Both are drawn from by standard normal noise, so that tries can be made to last.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from jaxtyping import Float, Int64
from torch import Tensor

_HALF_LOG_TWO_PI = 0.5 * math.log(2.0 * math.pi)


class DiagonalGaussian(NamedTuple):
    """Independent normal distributions of linear (m/s) and angular (rad/s) velocity. They are not truncated: the
    environment clips what it executes, and the log-probability is that of the unclipped sample.
    """

    mean: Float[Tensor, "B 2"]
    log_std: Float[Tensor, "2"]
    """Natural logarithm of the standard deviations, the same in every state."""

    @property
    def mode(self) -> Float[Tensor, "B 2"]:
        """The likeliest command."""
        return self.mean

    @property
    def std(self) -> Float[Tensor, "2"]:
        """Standard deviations of v and w."""
        return self.log_std.exp()

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

    def shares(self, commands: Float[Tensor, "#B C 2"]) -> Float[Tensor, "B C"]:
        """The probability of each of `commands`, if nothing else could be done: the densities there, brought to 1.
        The standard deviations are taken as given: no gradient reaches them.
        """
        apart = (commands - self.mean[:, None]) / self.std.detach()
        return torch.softmax(-0.5 * apart.square().sum(dim=2), dim=1)


class GridChoice(NamedTuple):
    """One of the commands of a grid."""

    log_probs: Float[Tensor, "B C"]
    """Natural logarithms of their probabilities."""
    grid: Float[Tensor, "C 2"]
    """The commands: every of some v, ascending, with every of some w, ascending and evenly apart."""

    @property
    def mode(self) -> Float[Tensor, "B 2"]:
        """The likeliest command."""
        return self.grid[self.log_probs.argmax(dim=1)]

    @property
    def std(self) -> Float[Tensor, "2"]:
        """Standard deviations of v and w: roots of the mean variance over the batch."""
        share = self.log_probs.exp()
        variance = share @ self.grid.square() - (share @ self.grid).square()
        return (variance.sum(dim=0) / max(1, len(share))).clamp(min=0.0).sqrt()

    def at(self, noise: Float[Tensor, "B 2"]) -> Float[Tensor, "B 2"]:
        """The draw that standard normal `noise` stands for: of its first number, the quantile along the grid."""
        below = self.log_probs.exp().cumsum(dim=1)
        # Rounding leaves the sum of all a little off 1, and lets far noise have the quantile 1.
        everything = below[:, -1:]
        quantile = (torch.special.ndtr(noise[:, :1]) * everything).minimum(
            everything.nextafter(everything.new_zeros(1))
        )
        return self.grid[(below <= quantile).sum(dim=1)]

    def log_prob(self, action: Float[Tensor, "B 2"]) -> Float[Tensor, "B"]:
        """Natural logarithm of the probability of `action`, a command of the grid."""
        return self.log_probs.gather(1, self._index(action)[:, None])[:, 0]

    def entropy(self) -> Float[Tensor, ""]:
        """Entropy in nats, mean over the batch."""
        return -(self.log_probs.exp() * self.log_probs).sum() / max(1, len(self.log_probs))

    def shares(self, commands: Float[Tensor, "#B C 2"]) -> Float[Tensor, "B C"]:
        """The probability of each of `commands`, all of the grid in any order."""
        index = self._index(commands)
        return self.log_probs.exp().gather(1, index.expand(len(self.log_probs), -1))

    def _index(self, commands: Float[Tensor, "*n 2"]) -> Int64[Tensor, "*n"]:
        apart = (commands[..., None, :] - self.grid).abs().sum(dim=-1)
        return apart.argmin(dim=-1)
