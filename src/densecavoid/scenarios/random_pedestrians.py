"""Training stage 3, Random-Pedestrians: halls in which people walk at random (paper, Training Scenarios)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from densecavoid.scenarios.levelled import Levelled
from densecavoid.scenarios.random_sparse_ped import wandering_hall
from densecavoid.sim.spec import WorldSpec


@dataclass(frozen=True)
class RandomPedestrians(Levelled):
    """Level 0 has one slow person, level 1 up to one for every 5 m2 at up to 1 m/s."""

    @property
    def name(self) -> str:
        return "random-pedestrians"

    def spawn(self, rng: np.random.Generator) -> WorldSpec:
        size = (rng.uniform(6.0, 12.0), rng.uniform(6.0, 12.0))
        people = 1 + int(rng.uniform(0.4, 1.0) * self.level * size[0] * size[1] / 5.0)
        speed = rng.uniform(0.2, 0.4 + 0.4 * self.level)
        return wandering_hall(
            rng,
            self.name,
            size,
            int(rng.uniform(0.0, 1.0) * size[0] * size[1] / 20.0),
            people,
            (speed, 0.15),
            (2.5, 7.0),
            rng.uniform(0.0, 0.2),
            time_limit_s=50.0,
        )
