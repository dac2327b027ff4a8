"""Training stage 1, Random Goal: an empty world and a goal anywhere around the robot (paper, Training Scenarios)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from densecavoid.scenarios.levelled import Levelled
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.spec import WorldSpec

_TURN_TIME_S = 12.0  # to face any direction, at .4 rad/s and with some hesitation


@dataclass(frozen=True)
class RandomGoal(Levelled):
    """Level 0 has goals 1 to 3 m away, level 1 up to 16 m; always in every direction."""

    @property
    def name(self) -> str:
        return "random-goal"

    def spawn(self, rng: np.random.Generator) -> WorldSpec:
        distance, direction = rng.uniform(1.0, 3.0 + 13.0 * self.level), rng.uniform(-math.pi, math.pi)
        return WorldSpec(
            scenario=self.name,
            floor_plan=FloorPlan(),
            start_pose=(0.0, 0.0, rng.uniform(-math.pi, math.pi)),
            goal=(distance * math.cos(direction), distance * math.sin(direction)),
            time_limit_s=_TURN_TIME_S + 3.0 * distance,
        )
