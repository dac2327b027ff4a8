"""How well navigators do: episodes, the figures of BENCHMARK.md, statistics and reports. Knows navigators by name.

Reports are in `benchmark.report`, which alone needs matplotlib.
"""

from densecavoid.benchmark.episode import Episode
from densecavoid.benchmark.navigators import make_navigator, navigator_names
from densecavoid.benchmark.rollout import run_episodes
from densecavoid.benchmark.runner import BenchmarkConfig, run_benchmark

__all__ = [
    "BenchmarkConfig",
    "Episode",
    "make_navigator",
    "navigator_names",
    "run_benchmark",
    "run_episodes",
]
