"""Running mean and variance of numbers, kept in a network's weights: whoever runs it normalises as training did."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

_LIMIT = 10.0
_LEAST_STD = 1e-4


class RunningMoments(nn.Module):
    """Mean and variance of `size` numbers over everything merged so far. Before the first merge: mean 0, variance 1."""

    def __init__(self, size: int) -> None:
        super().__init__()
        self.register_buffer("count", torch.zeros(1))
        self.register_buffer("mean", torch.zeros(size))
        self.register_buffer("variance", torch.ones(size))
        self.count: Tensor
        self.mean: Tensor
        self.variance: Tensor

    @property
    def std(self) -> Float[Tensor, "size"]:
        """Standard deviations, kept from 0."""
        return self.variance.sqrt().clamp(min=_LEAST_STD)

    def normalise(self, x: Float[Tensor, "*batch size"]) -> Float[Tensor, "*batch size"]:
        """(x - mean) / std, within +-10 so that what was never seen cannot drown the rest."""
        return ((x - self.mean) / self.std).clamp(-_LIMIT, _LIMIT)

    def restore(self, x: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
        """x std + mean: the way back from units of one standard deviation."""
        return x * self.std + self.mean

    def merge(self, count: Tensor, mean: Float[Tensor, "size"], variance: Float[Tensor, "size"]) -> None:
        """Takes in `count` samples of these moments (Chan, Golub, LeVeque 1979, parallel variance)."""
        total = self.count + count
        apart = mean - self.mean
        weight = (count / total).to(self.mean.dtype)
        self.variance.copy_(self.variance * (1 - weight) + variance * weight + apart.square() * weight * (1 - weight))
        self.mean.add_(apart * weight)
        self.count.copy_(total)
