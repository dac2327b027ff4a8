"""`oracle`: the full-knowledge planner as a navigator. It drives what was planned before the episode, and looks at
nothing; where no way was found it stands still."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Int

from densecavoid.benchmark.solvable import is_filtered, judgement_of
from densecavoid.frames import Command, SensorFrame, require
from densecavoid.sim.world import Simulator


class Oracle:
    """Satisfies `frames.Navigator`; must be told the worlds (`foretell`) before each reset."""

    name = "oracle"
    privileged = True

    def __init__(self) -> None:
        self._plans: list[np.ndarray] = []
        self._next = np.zeros(0, np.int64)

    def foretell(
        self, simulator: Simulator, seeds: Sequence[int] | Int[np.ndarray, "B"], which: Bool[np.ndarray, "B"]
    ) -> None:
        """Plans the marked worlds of a simulator.

        Raises:
            ValueError: when people react to the robot, or its wheels are not ideal: then nobody knows the future.
        """
        config = simulator.config
        require(config.people == "scripted", "people", config.people, "'scripted' for the oracle")
        require(config.dynamics == "ideal", "dynamics", config.dynamics, "'ideal' for the oracle")
        scenario = simulator.scenario
        require(is_filtered(scenario, config), "scenario", scenario.name, "people who do not react, for the oracle")
        if len(self._plans) != len(which):
            self._plans = [np.zeros((0, 2))] * len(which)
        for b in np.flatnonzero(which).tolist():
            plan = judgement_of(scenario, int(seeds[b]), config).plan
            self._plans[b] = np.zeros((0, 2)) if plan is None else plan.commands

    def reset(self, which: Bool[np.ndarray, "B"]) -> None:
        """Starts the marked worlds' plans from the beginning."""
        if len(self._next) != len(which):
            self._next = np.zeros(len(which), np.int64)
        self._next[which] = 0

    def act(self, frame: SensorFrame) -> Command:
        """The next command of each plan; standing still after its end.

        Raises:
            ValueError: if the worlds of the frame have not been foretold.
        """
        require(frame.num_worlds == len(self._plans), "worlds of the frame", frame.num_worlds, "those foretold")
        velocities = np.zeros((frame.num_worlds, 2), np.float32)
        for b, (plan, k) in enumerate(zip(self._plans, self._next, strict=True)):
            if k < len(plan):
                velocities[b] = plan[k]
        self._next += 1
        return Command(velocities[:, 0], velocities[:, 1])
