"""Test `robot-freezing`: people suddenly stand side by side across the robot's way (BENCHMARK, The four tests)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from densecavoid.frames import require
from densecavoid.scenarios.corridor import corridor_plan
from densecavoid.sim.people import STANDING, sample_bodies
from densecavoid.sim.spec import Appearance, Crowd, WorldSpec

BANDS_M = ((0.5, 1.0), (1.0, 1.5), (1.5, 2.0))
_START_X = 1.0
_SIDE_GAP_M = 1.0
_OVERHANG_M = 0.3  # the line reaches at least so far to either side of the corridor's middle


def sudden_line(
    rng: np.random.Generator, name: str, width: float, goal_ahead_m: float, band_m: tuple[float, float]
) -> WorldSpec:
    """A corridor in which 3 or 4 people appear when the robot has come 3 m, and stay standing.

    They stand too close to pass between; at least 1 m stays free beside them on one side.

    Raises:
        ValueError: if the corridor is too narrow for that.
    """
    for _ in range(100):
        count = int(rng.integers(3, 5))
        radius_m, height_m = sample_bodies(rng, count)
        gaps = rng.uniform(0.05, 0.3, count - 1)
        extent = 2 * float(radius_m.sum()) + float(gaps.sum())
        # From the wall on the near side (at -width/2) to where the free gap begins, over the corridor's middle.
        low, high = max(-width / 2 + 0.02, _OVERHANG_M - extent), min(-_OVERHANG_M, width / 2 - _SIDE_GAP_M - extent)
        if low <= high:
            break
    else:
        raise ValueError(
            f"{name}: a corridor of {width} m has no room for a line of people and a gap of {_SIDE_GAP_M} m"
        )
    edge = rng.uniform(low, high)
    y = edge + radius_m + np.concatenate([[0.0], np.cumsum(2 * radius_m[:-1] + gaps)])
    y *= rng.choice([-1.0, 1.0])
    place = np.stack([np.zeros(count), y], axis=1)
    side = width / 2 - 1.0
    return WorldSpec(
        scenario=name,
        floor_plan=corridor_plan(width, goal_ahead_m + 6.0),
        start_pose=(_START_X, rng.uniform(-0.3, 0.3), rng.uniform(-0.1, 0.1)),
        goal=(_START_X + goal_ahead_m, rng.uniform(-side, side)),
        crowd=Crowd(place, place, np.full(count, 0.5), radius_m, height_m, np.full(count, STANDING)),
        appearance=Appearance(trigger_distance_m=3.0, distance_m=rng.uniform(*band_m)),
    )


@dataclass(frozen=True)
class RobotFreezing:
    """Corridor of 4 m, goal 10 m ahead; the nearest body surface appears at a distance within `band_m`."""

    band_m: tuple[float, float] = (1.0, 1.5)

    def __post_init__(self) -> None:
        require(self.band_m in BANDS_M, "RobotFreezing.band_m", self.band_m, f"one of {BANDS_M}")

    @property
    def name(self) -> str:
        return f"robot-freezing:{self.band_m[0]}-{self.band_m[1]}"

    def spawn(self, rng: np.random.Generator) -> WorldSpec:
        return sudden_line(rng, self.name, 4.0, 10.0, self.band_m)
