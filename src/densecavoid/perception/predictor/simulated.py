"""Windows out of the simulator's crowds: walks through doors, around corners and past furniture, at all paces."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import numpy as np
from jaxtyping import Float

from densecavoid.frames import Command
from densecavoid.perception.predictor.windows import Windows, cut, join
from densecavoid.scenarios.registry import make_scenario
from densecavoid.sim.config import ATTITUDES, PACES, Attitudes, Pace, SimConfig
from densecavoid.sim.world import Simulator

SCENARIOS = (
    "random-pedestrians",
    "dense-random-pedestrians",
    "doorway",
    "lobby",
    "l-corridor",
    "crossing",
    "plaza",
)
"""None of the tests is among them."""
_WORLDS = 16
_SECONDS = 12.0
_DT_S = 0.1


def simulated_windows(seen: int, ahead: Sequence[int], stride: int, seed: int) -> Windows:
    """Windows of .1 s from 16 worlds of each scenario; the robot stands. Arguments as in `windows.cut`."""
    parts = []
    for number, name in enumerate(SCENARIOS):
        pace, people = PACES[number % len(PACES)], ATTITUDES[number % len(ATTITUDES)]
        for places in _places(name, cast(Pace, pace), cast(Attitudes, people), seed + number):
            parts.append(cut(places, _DT_S, seen, ahead, stride=stride))
    return join([part for part in parts if len(part)])


def _places(scenario: str, pace: Pace, people: Attitudes, seed: int) -> Float[np.ndarray, "B T P 2"]:
    """Everybody's places in each world; NaN where a slot is empty or holds somebody else than before."""
    simulator = Simulator(make_scenario(scenario), _WORLDS, SimConfig(pace=pace, people=people, threads=1))
    simulator.reset(seed * _WORLDS + np.arange(_WORLDS))
    still, places = Command(np.zeros(_WORLDS), np.zeros(_WORLDS)), []
    for _ in range(round(_SECONDS / _DT_S)):
        crowd = simulator.people()
        places.append(np.where(crowd.active[..., None], crowd.pos_w, np.nan))
        simulator.step(still)
    walks = np.stack(places, axis=1).astype(np.float64)
    # Whoever comes in again at an entrance, or appears out of nothing, is cut off from what the slot did before.
    jumps = np.linalg.norm(np.diff(walks, axis=1), axis=3) > 0.5
    walks[:, 1:][jumps] = np.nan
    return walks
