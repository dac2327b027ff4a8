"""Small worlds with given people, for the tests of crowds."""

from __future__ import annotations

from typing import Any

import numpy as np

from densecavoid.frames import Command
from densecavoid.sim.config import SimConfig
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.people import TRAVERSING
from densecavoid.sim.spec import Crowd, WorldSpec
from densecavoid.sim.world import Simulator

MOTIONS = ("anticipation", "social-force", "orca")


class Given:
    """Always the same world, or whatever `make` draws."""

    name = "given"

    def __init__(self, make) -> None:
        self.make = make

    def spawn(self, rng: np.random.Generator) -> WorldSpec:
        return self.make(rng)


def crowd(pos: Any, goal: Any, speed: Any = 1.0, behaviour: Any = TRAVERSING, radius: Any = 0.25, **more: Any) -> Crowd:
    """People of one kind."""
    pos, goal = np.atleast_2d(np.asarray(pos, float)), np.atleast_2d(np.asarray(goal, float))
    count = len(pos)
    return Crowd(
        pos,
        goal,
        np.broadcast_to(np.asarray(speed, float), count).copy(),
        np.broadcast_to(np.asarray(radius, float), count).copy(),
        np.full(count, 1.7),
        np.broadcast_to(np.asarray(behaviour), count).copy(),
        **more,
    )


def simulate(people: Crowd, plan: FloorPlan | None = None, config: SimConfig | None = None, **world: Any) -> Simulator:
    """One world with these people; the robot is far away unless told otherwise."""
    values: dict[str, Any] = {
        "scenario": "given",
        "floor_plan": plan or FloorPlan(),
        "start_pose": (-500.0, 0.0, 0.0),
        "goal": (900.0, 0.0),
        "crowd": people,
        "time_limit_s": 1e6,
        **world,
    }
    spec = WorldSpec(**values)
    sim = Simulator(Given(lambda rng: spec), 1, config or SimConfig(threads=1))
    sim.reset(np.zeros(1, np.int64))
    return sim


def go(sim: Simulator, seconds: float, speed: float = 0.0) -> None:
    """Steps for so long, with a constant command."""
    for _ in range(round(seconds / sim.config.control_dt_s)):
        sim.step(Command(np.full(sim.num_worlds, speed), np.zeros(sim.num_worlds)))
