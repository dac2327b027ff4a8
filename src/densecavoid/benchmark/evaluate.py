"""One navigator in one scenario, from Python: the benchmark's figures without its files."""

from __future__ import annotations

from pathlib import Path

from densecavoid.benchmark.metrics import episode_metrics, summarise
from densecavoid.benchmark.rollout import run_episodes
from densecavoid.benchmark.runner import TEST_SEEDS_START
from densecavoid.benchmark.solvable import admit
from densecavoid.frames import Navigator, require
from densecavoid.scenarios import make_scenario
from densecavoid.sim.spec import Scenario
from densecavoid.sim.world import SimConfig, Simulator


def evaluate(
    navigator: Navigator,
    scenario: Scenario | str,
    episodes: int = 100,
    *,
    config: SimConfig | None = None,
    batch_size: int = 16,
    data: Path | None = None,
) -> dict[str, object]:
    """Success, collisions, freezing and the other figures of BENCHMARK.

    On the first of the benchmark's test worlds that can be solved; judging new ones takes .2 s each, once.

    Args:
        navigator: who drives.
        scenario: where, by name or as an object.
        episodes: how many worlds.
        config: the body; the paper's (ideal, clean) by default.
        batch_size: worlds simulated at once; the figures do not depend on it.
        data: folder of the recordings, for scenarios that need them.

    Returns:
        The figures of one cell of the benchmark's `results.json`.

    Raises:
        ValueError: for an unknown scenario or a number of episodes below 1.
    """
    require(episodes >= 1, "episodes", episodes, "at least 1")
    scenario = make_scenario(scenario, data) if isinstance(scenario, str) else scenario
    simulator = Simulator(scenario, min(batch_size, episodes), config)
    admission = admit(scenario, simulator.config, TEST_SEEDS_START, episodes)
    require(len(admission.seeds) > 0, f"worlds of {scenario.name} that can be solved", 0, "at least one")
    figures = []
    for episode in run_episodes(simulator, navigator, admission.seeds):
        judgement = admission.judgements[episode.seed]
        reference_s = None if judgement.plan is None else judgement.plan.time_s
        figures.append(episode_metrics(episode, None, reference_s, judgement.density_per_m2))
    return summarise(figures)
