"""RobustTP's network (torch): LSTM encoders, social grids with a shared CNN, an LSTM decoder, a bivariate Gaussian.

After the public descriptions of TraPHic (Chandra et al. 2019) and RobustTP (Chandra et al. 2019). What is ours: metres
relative to the track and its walking direction instead of pixels scaled axis by axis; places that are missing carry a
mask; the Gaussian is around the constant-velocity line; a cell's neighbour is found by where it stands, not by its
place in a list. Each track is encoded once, in its own direction; where it stands for another is added afterwards.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn
from torch.nn import functional

from densecavoid.frames import require
from densecavoid.perception.predictor.compact import gaussians
from densecavoid.perception.predictor.grids import HORIZON_GRID, NEIGHBOUR_GRID, NUM_CELLS, PAIR


@dataclass(frozen=True)
class RobustTPConfig:
    """Widths of the layers; the defaults are those of the public description."""

    samples: int = 8
    """Places of a history."""
    horizons_s: tuple[float, ...] = tuple(round(0.4 * step, 1) for step in range(1, 13))
    embedding: int = 32
    encoder: int = 64
    own_width: int = 32
    channels: int = 16
    decoder: int = 128
    dropout: float = 0.2

    def __post_init__(self) -> None:
        require(self.samples >= 2, "RobustTPConfig.samples", self.samples, "2 or more")
        require(0 <= self.dropout < 1, "RobustTPConfig.dropout", self.dropout, "in [0, 1)")
        for name in ("embedding", "encoder", "own_width", "channels", "decoder"):
            require(getattr(self, name) > 0, f"RobustTPConfig.{name}", getattr(self, name), "positive")


class RobustTP(nn.Module):
    """The whole network; inputs are those of `grids.GridFeatures`."""

    horizons: Tensor

    def __init__(self, config: RobustTPConfig) -> None:
        super().__init__()
        self.config = config
        self.embed_place = nn.Linear(2, config.embedding)
        self.embed_velocity = nn.Linear(2, config.embedding)
        self.encoder = nn.LSTM(2 * config.embedding, config.encoder, batch_first=True)
        self.own = nn.Linear(config.encoder, config.own_width)
        self.other = nn.Linear(config.encoder + PAIR, config.encoder)
        self.conv_block = nn.Sequential(
            nn.Conv2d(config.encoder, config.encoder, 3), nn.ELU(), nn.BatchNorm2d(config.encoder)
        )
        self.conv_column = nn.Conv2d(config.encoder, config.channels, (3, 1))
        self.dropout = nn.Dropout(config.dropout)
        # 13 x 3: 11 x 1 after the block, 9 x 1 after the column, 5 x 1 pooled; 7 x 3: 5, 3, 2.
        pooled = [(grid[0] - 4 + 1) // 2 for grid in (NEIGHBOUR_GRID, HORIZON_GRID)]
        context = config.own_width + config.channels * sum(pooled)
        self.decoder = nn.LSTM(context, config.decoder, batch_first=True)
        self.output = nn.Linear(config.decoder, 5)
        nn.init.zeros_(self.output.weight)  # to begin with, constant velocity
        nn.init.zeros_(self.output.bias)
        self.register_buffer("horizons", torch.tensor(config.horizons_s), persistent=False)

    def forward(
        self,
        own: Float[Tensor, "N H 5"],
        neighbour: Int[Tensor, "N M"],
        pair: Float[Tensor, "N M 5"],
        cells: Float[Tensor, "N M C"],
    ) -> Float[Tensor, "N S 5"]:
        """See `compact.gaussians` for what comes out."""
        there = own[..., 4:]
        embedded = torch.cat([self.embed_place(own[..., :2]), self.embed_velocity(own[..., 2:4])], dim=2)
        state = self.encoder(functional.elu(embedded) * there)[0][:, -1]
        others = self.other(torch.cat([state[neighbour], pair], dim=2)) * pair[..., 4:]
        grids = torch.matmul(others.transpose(1, 2), cells)  # [N, features, cells]
        near = grids[..., : NUM_CELLS[0]].unflatten(2, NEIGHBOUR_GRID)
        ahead = grids[..., NUM_CELLS[0] :].unflatten(2, HORIZON_GRID)
        context = torch.cat([functional.elu(self.own(state)), self._look(near), self._look(ahead)], dim=1)
        steps = context[:, None].expand(-1, len(self.config.horizons_s), -1)
        return gaussians(self.output(self.decoder(steps)[0]), self.horizons)

    def _look(self, grid: Float[Tensor, "N F R 3"]) -> Float[Tensor, "N G"]:
        column = functional.elu(self.dropout(self.conv_column(self.conv_block(grid))))
        return functional.max_pool2d(column, (2, 1), ceil_mode=True).flatten(1)
