"""A mixture of scenarios: each world is drawn from one of them. Itself a scenario."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from densecavoid.frames import require
from densecavoid.sim.spec import Scenario, WorldSpec


@dataclass(frozen=True)
class Mixture:
    """Draws from `scenarios` in proportion to `weights`."""

    scenarios: tuple[Scenario, ...]
    weights: tuple[float, ...]

    def __post_init__(self) -> None:
        require(len(self.scenarios) > 0, "Mixture.scenarios", self.scenarios, "at least one")
        require(len(self.weights) == len(self.scenarios), "Mixture.weights", self.weights, "one for each scenario")
        require(
            min(self.weights) >= 0 and sum(self.weights) > 0, "Mixture.weights", self.weights, "not negative, not all 0"
        )

    @property
    def name(self) -> str:
        return "+".join(scenario.name for scenario in self.scenarios)

    def spawn(self, rng: np.random.Generator) -> WorldSpec:
        share = np.array(self.weights) / sum(self.weights)
        return self.scenarios[int(rng.choice(len(share), p=share))].spawn(rng)
