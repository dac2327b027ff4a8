"""Scenarios by name: four of training, the tests, places, recorded crowds, and the user's own building."""

from __future__ import annotations

from pathlib import Path

from densecavoid.scenarios.cluttered_static import ClutteredStatic
from densecavoid.scenarios.corridor import Corridor15, DensePed
from densecavoid.scenarios.crossing import Crossing
from densecavoid.scenarios.dense_random_pedestrians import DenseRandomPedestrians
from densecavoid.scenarios.dense_static import DenseStatic
from densecavoid.scenarios.doorway import Doorway
from densecavoid.scenarios.l_corridor import LCorridor
from densecavoid.scenarios.lobby import Lobby
from densecavoid.scenarios.own_building import own_building
from densecavoid.scenarios.plaza import Plaza
from densecavoid.scenarios.random_goal import RandomGoal
from densecavoid.scenarios.random_pedestrians import RandomPedestrians
from densecavoid.scenarios.random_sparse_ped import RandomSparsePed
from densecavoid.scenarios.recorded import recorded_scenario
from densecavoid.scenarios.robot_freezing import BANDS_M, RobotFreezing
from densecavoid.sim.spec import Scenario

TrainingScenario = RandomGoal | ClutteredStatic | RandomPedestrians | DenseRandomPedestrians
"""Training scenarios have a `level` in [0, 1], the curriculum's dial."""
Place = Doorway | Lobby | LCorridor | Crossing | Plaza
"""Places have one too."""

TRAINING: dict[str, TrainingScenario] = {
    scenario.name: scenario
    for scenario in (RandomGoal(), ClutteredStatic(), RandomPedestrians(), DenseRandomPedestrians())
}
"""In the order of the paper's curriculum."""

TESTING: dict[str, Scenario] = {
    scenario.name: scenario
    for scenario in (DenseStatic(), RandomSparsePed(), DensePed(), Corridor15(), *map(RobotFreezing, BANDS_M))
}

PLACES: dict[str, Place] = {
    scenario.name: scenario for scenario in (Doorway(), Lobby(), LCorridor(), Crossing(), Plaza())
}
"""Places of everyday life, each with a `level`: free to use in training and demonstrations."""


def names() -> tuple[str, ...]:
    """All scenarios that need no data."""
    return (*TRAINING, *TESTING, *PLACES)


def make_scenario(name: str, data: Path | None = None) -> Scenario:
    """The scenario of that name.

    Args:
        name: one of `names()`, `hermes:<run>[:reactive]`, `tracks:FILE[:reactive]`, `map:FILE[:PEOPLE]` (a ROS map) or
            `plan:FILE` (a floor plan in TOML).
        data: folder of the recordings, for `hermes`.

    Raises:
        ValueError: if there is none, saying what there is.
    """
    if name.startswith(("hermes:", "tracks:")) or name in ("hermes", "tracks"):
        return recorded_scenario(name, data)
    if name.startswith(("map:", "plan:")) or name in ("map", "plan"):
        return own_building(name)
    known: dict[str, Scenario] = {**TRAINING, **TESTING, **PLACES}
    if name not in known:
        raise ValueError(
            f"unknown scenario {name!r}, expected one of: {', '.join(known)}, "
            "hermes:<run>[:reactive], tracks:FILE[:reactive], map:FILE[:PEOPLE], plan:FILE"
        )
    return known[name]
