"""Whether planning among tracked people brings a robot through them."""

from __future__ import annotations

import numpy as np
import pytest

from densecavoid.baselines.lookahead import Lookahead
from densecavoid.benchmark.rollout import run_episodes
from densecavoid.scenarios import make_scenario
from densecavoid.sim.world import SimConfig, Simulator


@pytest.mark.slow
def test_most_dense_corridors_are_crossed() -> None:
    """With people as its own detector and tracker see them."""
    episodes = run_episodes(Simulator(make_scenario("dense-ped"), 10, SimConfig()), Lookahead(), list(range(10)))
    assert np.mean([episode.outcome == "success" for episode in episodes]) >= 0.7
