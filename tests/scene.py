"""A robot at the origin that looks along x, in a place of one's own."""

from __future__ import annotations

import numpy as np

from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.spec import Crowd, WorldSpec


class Scene:
    """Its only world."""

    name = "scene"

    def __init__(self, plan: FloorPlan, crowd: Crowd | None = None) -> None:
        self.spec = WorldSpec("scene", plan, (0.0, 0.0, 0.0), (20.0, 0.0), crowd or Crowd.nobody())

    def spawn(self, rng: np.random.Generator) -> WorldSpec:
        return self.spec
