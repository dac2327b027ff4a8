"""Randomised bodies and places for training, off by default: sensors' errors and delays, the robot's dynamics, and how
people take it, differ from group to group of the worlds; walls and furniture come from more places.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from densecavoid.frames import require
from densecavoid.scenarios.mixture import Mixture
from densecavoid.scenarios.registry import PLACES
from densecavoid.sim.config import ATTITUDES, SimConfig
from densecavoid.sim.noise import SensorNoiseConfig
from densecavoid.sim.spec import Scenario

_GREATEST_FACTOR = 2.0
_MOST_DELAY_STEPS = 2
_SHARES = {"lidar_dropout", "camera_dropout", "lidar_glass", "camera_glass"}


@dataclass(frozen=True)
class VarietyConfig:
    """What is randomised besides what scenarios draw anyway (sizes, walls, things, people's number and speed)."""

    bodies: int = 0
    """Groups of worlds, each with a body of its own: real sensors with errors between half and twice the datasheets',
    0 to 2 control steps of delay, ideal or dynamic driving, people who ignore the robot, make way, or both. 0 = off."""
    places: float = 0.0
    """Share of worlds that are doorways, lobbies, corners, crossings and plazas, at the stage's level. 0 = off."""

    def __post_init__(self) -> None:
        require(self.bodies >= 0, "VarietyConfig.bodies", self.bodies, "0 or more")
        require(0 <= self.places < 1, "VarietyConfig.places", self.places, "in [0, 1)")


def vary_body(sim: SimConfig, seed: int, group: int) -> SimConfig:
    """The body of one group of worlds, drawn from (seed, group)."""
    rng = np.random.default_rng([seed, group])
    factors = _GREATEST_FACTOR ** rng.uniform(-1.0, 1.0, len(fields(SensorNoiseConfig)))
    scaled = {}
    for field, factor in zip(fields(SensorNoiseConfig), factors, strict=True):
        value = getattr(sim.noise, field.name) * float(factor)
        scaled[field.name] = min(value, 1.0) if field.name in _SHARES else value
    late_scan, late_image = (int(steps) * sim.control_dt_s for steps in rng.integers(0, _MOST_DELAY_STEPS + 1, 2))
    return replace(
        sim,
        sensors="real",
        noise=SensorNoiseConfig(**scaled),
        lidar=replace(sim.lidar, latency_s=late_scan),
        camera=replace(sim.camera, latency_s=late_image),
        dynamics=("ideal", "dynamic")[rng.integers(2)],
        people=ATTITUDES[rng.integers(len(ATTITUDES))],
    )


def vary_places(scenario: Scenario, share: float, level: float) -> Scenario:
    """The scenario, mixed with places of everyday life at `level`."""
    if share == 0.0:
        return scenario
    places = tuple(place.at_level(level) for place in PLACES.values())
    return Mixture((scenario, *places), (1.0 - share, *(share / len(places) for _ in places)))
