"""Worlds of people who stand where a test puts them, and what a robot at the origin sees of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from densecavoid.frames import CameraConfig
from densecavoid.perception.detector.views import Views, look
from densecavoid.sim.config import SimConfig
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.people import STANDING
from densecavoid.sim.spec import Crowd, WorldSpec
from densecavoid.sim.world import Simulator


class Standing:
    """People of .25 m and 1.7 m who look along -x, at rows (x, y)."""

    name = "standing"

    def __init__(self, places: Sequence[tuple[float, float]], plan: FloorPlan | None = None) -> None:
        pos = np.array(places, float).reshape(-1, 2)
        one = np.ones(len(pos))
        crowd = Crowd(pos, pos - [1.0, 0.0], one, 0.25 * one, 1.7 * one, np.full(len(pos), STANDING))
        self.spec = WorldSpec(self.name, plan or FloorPlan(), (0.0, 0.0, 0.0), (50.0, 0.0), crowd)

    def spawn(self, rng: np.random.Generator) -> WorldSpec:
        return self.spec


def view_of(
    places: Sequence[tuple[float, float]],
    plan: FloorPlan | None = None,
    camera: CameraConfig | None = None,
    sensors: str = "clean",
    seed: int = 0,
) -> Views:
    """One labelled image."""
    camera = camera or CameraConfig()
    sim = Simulator(Standing(places, plan), 1, SimConfig(camera=camera, sensors=sensors, threads=1))  # type: ignore[arg-type]
    sim.reset(np.array([seed]))
    return look(sim, camera, np.array([seed]))
