"""Training stage 4, Dense-Random-Pedestrians: crowds in halls and corridors, and people who appear suddenly (paper)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from densecavoid.scenarios.corridor import oncoming_corridor
from densecavoid.scenarios.levelled import Levelled
from densecavoid.scenarios.random_sparse_ped import wandering_hall
from densecavoid.scenarios.robot_freezing import sudden_line
from densecavoid.sim.spec import WorldSpec


@dataclass(frozen=True)
class DenseRandomPedestrians(Levelled):
    """Corridors with people coming against the robot, crowded halls and sudden appearances, of random sizes.

    Level 0 has few and slow people, level 1 more than the tests have.
    """

    @property
    def name(self) -> str:
        return "dense-random-pedestrians"

    def spawn(self, rng: np.random.Generator) -> WorldSpec:
        kind = rng.choice(["corridor", "hall", "sudden"], p=[0.5, 0.3, 0.2])
        if kind == "corridor":
            people = 2 + int(rng.uniform(0.4, 1.0) * self.level * 18)
            speed = rng.uniform(0.2, 0.35 + 0.35 * self.level)
            width, goal_ahead = rng.uniform(3.2, 5.5), rng.uniform(8.0, 17.0)
            spread = rng.uniform(1.0, 2.2) * people / width + 4.0
            return oncoming_corridor(
                rng, self.name, width, goal_ahead + 8.0, people, (speed, 0.12), (3.0, 3.0 + spread), goal_ahead
            )
        if kind == "hall":
            size = (rng.uniform(6.0, 10.0), rng.uniform(6.0, 10.0))
            people = 3 + int(rng.uniform(0.5, 1.0) * self.level * size[0] * size[1] / 4.0)
            speed = rng.uniform(0.2, 0.4 + 0.4 * self.level)
            pillars = int(rng.integers(0, 3))
            return wandering_hall(rng, self.name, size, pillars, people, (speed, 0.15), (3.0, 7.0), 0.1)
        nearest = rng.uniform(0.8, 2.6)
        return sudden_line(rng, self.name, rng.uniform(3.6, 5.0), rng.uniform(7.0, 11.0), (nearest, nearest))
