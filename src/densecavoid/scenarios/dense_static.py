"""Test `dense-static`: a 10 x 10 m room with 25 to 35 obstacles (BENCHMARK, The four tests)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from densecavoid.scenarios.cluttered_static import cluttered_room
from densecavoid.sim.spec import WorldSpec


@dataclass(frozen=True)
class DenseStatic:
    """Boxes, pillars, tables and chairs; start and goal at least 6 m apart; a way of .45 m clearance exists."""

    @property
    def name(self) -> str:
        return "dense-static"

    def spawn(self, rng: np.random.Generator) -> WorldSpec:
        return cluttered_room(rng, self.name, (10.0, 10.0), int(rng.integers(25, 36)), (6.0, 14.0))
