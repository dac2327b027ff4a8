"""The compact predictor's network (torch): a correction to constant velocity from own past and nearest neighbours."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn

from densecavoid.frames import require
from densecavoid.perception.predictor.features import NEIGHBOUR_NUMBERS, own_size

_NEIGHBOUR_SCALE = (0.3, 0.3, 1.0, 1.0, 1.0)  # metres to about one
_MAX_CORRELATION = 0.95
MEAN_SCALE = 0.3
"""m/s; a network output of one moves the mean by so much a second."""
STD_AT_START, STD_GROWTH = 0.02, 0.2
"""m and m/s; a network output of zero stands for this standard deviation."""


@dataclass(frozen=True)
class CompactConfig:
    """Widths of the layers."""

    samples: int = 32
    """Places of a history."""
    horizons_s: tuple[float, ...] = (0.1, 0.4, 0.8, 1.2)
    neighbour_width: int = 32
    first_width: int = 128
    second_width: int = 96

    def __post_init__(self) -> None:
        require(self.samples >= 2, "CompactConfig.samples", self.samples, "2 or more")
        for name in ("neighbour_width", "first_width", "second_width"):
            require(getattr(self, name) > 0, f"CompactConfig.{name}", getattr(self, name), "positive")


class CompactNetwork(nn.Module):
    """A small network over each neighbour, the maximum over neighbours, then two hidden layers."""

    horizons: Tensor
    scale: Tensor

    def __init__(self, config: CompactConfig) -> None:
        super().__init__()
        self.config = config
        width = config.neighbour_width
        self.neighbour = nn.Sequential(
            nn.Linear(NEIGHBOUR_NUMBERS + 1, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU()
        )
        self.head = nn.Sequential(
            nn.Linear(own_size(config.samples) + width, config.first_width),
            nn.ReLU(),
            nn.Linear(config.first_width, config.second_width),
            nn.ReLU(),
            nn.Linear(config.second_width, 5 * len(config.horizons_s)),
        )
        last = self.head[-1]
        assert isinstance(last, nn.Linear)
        nn.init.zeros_(last.weight)  # to begin with, constant velocity
        nn.init.zeros_(last.bias)
        self.register_buffer("horizons", torch.tensor(config.horizons_s), persistent=False)
        self.register_buffer("scale", torch.tensor(_NEIGHBOUR_SCALE), persistent=False)

    def forward(self, own: Float[Tensor, "N A"], neighbours: Float[Tensor, "N K 5"]) -> Float[Tensor, "N S 5"]:
        """See `gaussians`; the inputs are `features.Features`'."""
        speed = own[:, None, -1:].expand(-1, neighbours.shape[1], -1)
        seen = self.neighbour(torch.cat([neighbours * self.scale, speed], dim=2)) * neighbours[..., 4:]
        raw = self.head(torch.cat([own, seen.amax(dim=1)], dim=1))
        return gaussians(raw.view(-1, len(self.config.horizons_s), 5), self.horizons)


def gaussians(raw: Float[Tensor, "N S 5"], horizons_s: Tensor) -> Float[Tensor, "N S 5"]:
    """A network's last numbers as correction ahead and left (m), standard deviations ahead and left (m), correlation.

    All zeros are constant velocity with a standard deviation that grows with time.
    """
    horizon = horizons_s[None, :, None]
    mean = raw[..., :2] * horizon * MEAN_SCALE
    std = torch.exp(raw[..., 2:4].clamp(-8.0, 8.0)) * (STD_AT_START + STD_GROWTH * horizon)
    return torch.cat([mean, std, _MAX_CORRELATION * torch.tanh(raw[..., 4:])], dim=2)
