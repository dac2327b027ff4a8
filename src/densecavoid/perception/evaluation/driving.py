"""Robots that drive about at random, to measure perception with: what they will do is not known to it either."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Int

from densecavoid.frames import Command, SensorFrame
from densecavoid.sim.world import Simulator

_CHANGES_PER_S = 1.0


class Moment(NamedTuple):
    """What all robots sense at one instant."""

    frame: SensorFrame
    episode: Int[np.ndarray, "B"]
    """Number of each world's episode; no two have the same."""
    fresh: Bool[np.ndarray, "B"]
    """Worlds whose episode begins here."""


def drive_about(simulator: Simulator, steps: int, seed: int) -> Iterator[Moment]:
    """Each moment of so many control steps; the robots change their velocity about once a second.

    An episode that ends begins anew in another world. The frames' arrays are written again by the next moment.
    """
    rng, worlds = np.random.default_rng(seed), simulator.num_worlds
    robot, dt = simulator.config.robot, simulator.config.control_dt_s
    limits = np.array([robot.max_linear_velocity, robot.max_angular_velocity])
    command = np.zeros((worlds, 2))
    episode, fresh = np.arange(worlds), np.ones(worlds, np.bool_)
    simulator.reset(rng.integers(2**62, size=worlds))
    for _ in range(steps):
        yield Moment(simulator.sense(), episode.copy(), fresh)
        anew = fresh | (rng.random(worlds) < dt * _CHANGES_PER_S)
        command[anew] = rng.uniform([0.0, -1.0], 1.0, (int(anew.sum()), 2)) * limits
        simulator.step(Command(*command.T.astype(np.float32)))
        fresh = simulator.done.copy()
        if fresh.any():
            episode[fresh] += worlds
            simulator.reset(rng.integers(2**62, size=worlds), fresh)
