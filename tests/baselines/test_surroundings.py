"""Whom classical navigators know of."""

from __future__ import annotations

import numpy as np

from densecavoid.baselines.surroundings import PeopleAround
from densecavoid.frames import Command
from densecavoid.sim.floorplan import FloorPlan
from densecavoid.sim.people import STANDING
from densecavoid.sim.spec import Crowd
from densecavoid.sim.world import SimConfig, Simulator
from scene import Scene


def test_who_stands_too_near_for_the_camera_is_known_by_the_legs_where_that_is_asked_for() -> None:
    """A metre ahead; who never walked could be a table to the lidar."""
    place, one = np.array([[1.0, 0.1]]), np.ones(1)
    crowd = Crowd(place, place, 0.5 * one, 0.26 * one, 1.7 * one, np.full(1, STANDING))
    sim = Simulator(Scene(FloorPlan(), crowd), 1, SimConfig(threads=1))
    sim.reset(np.zeros(1, np.int64))
    walkers, all_legs = PeopleAround(), PeopleAround(standing=True)
    for around in (walkers, all_legs):
        around.reset(np.ones(1, np.bool_))
    for _ in range(20):
        sim.step(Command(np.zeros(1, np.float32), np.zeros(1, np.float32)))
        walkers.see(sim.sense())
        all_legs.see(sim.sense())
    sure, may_be = walkers.see(sim.sense()), all_legs.see(sim.sense())
    assert not sure.there.any()
    assert may_be.there.sum() == 1
    there = may_be.there
    assert np.hypot(*(may_be.pos_r[there][0] - (1.0, 0.1))) < 0.15
    assert (may_be.vel_r[there] == 0.0).all() and 0.15 < may_be.radius_m[there][0] < 0.4
