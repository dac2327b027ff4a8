"""What draws are made from: the same numbers in every episode, step by step, so that an episode does not depend on
which others are driven beside it or were before.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

_MORE = 1024


class EpisodeNoise:
    """Standard normal numbers, two a step, for each of some worlds."""

    def __init__(self, seed: int, num_worlds: int) -> None:
        self._rng = np.random.default_rng(seed)
        self._noise = np.zeros((0, 2))
        self._steps = np.zeros(num_worlds, np.int64)

    def reset(self, which: Bool[np.ndarray, "B"]) -> None:
        """Begins anew in the marked worlds; their number sets the batch size."""
        if len(which) != len(self._steps):
            self._steps = np.zeros(len(which), np.int64)
        self._steps[which] = 0

    def next(self) -> Float[np.ndarray, "B 2"]:
        """The next numbers of all worlds."""
        while self._steps.max(initial=0) >= len(self._noise):
            self._noise = np.concatenate([self._noise, self._rng.standard_normal((_MORE, 2))])
        noise = self._noise[self._steps]
        self._steps += 1
        return noise
