"""How sure a number is: intervals of rates and of paired differences. Plain statistics, knows nothing of robots."""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from jaxtyping import Float

from densecavoid.frames import require


@dataclass(frozen=True)
class Difference:
    """The mean of a - b, over pairs or of two samples, with its percentile bootstrap interval."""

    mean: float
    low: float
    high: float

    @property
    def excludes_zero(self) -> bool:
        """Whether the interval says that the two differ."""
        return self.low > 0 or self.high < 0


def wilson_interval(successes: int, trials: int, confidence: float = 0.95) -> tuple[float, float]:
    """The score interval of a rate (E. B. Wilson, JASA 22, 1927), without continuity correction.

    Args:
        successes: How often it happened.
        trials: How often it was tried; with none the interval is [0, 1].
        confidence: The share of such intervals that hold the true rate.

    Returns:
        Lower and upper end, in [0, 1].

    Raises:
        ValueError: for counts that cannot be, or a confidence outside (0, 1).
    """
    require(trials >= 0, "trials", trials, "0 or more")
    require(0 <= successes <= trials, "successes", successes, f"in [0, {trials}]")
    require(0 < confidence < 1, "confidence", confidence, "in (0, 1)")
    if trials == 0:
        return 0.0, 1.0
    z = NormalDist().inv_cdf((1 + confidence) / 2)
    rate = successes / trials
    shrunk = (rate + z * z / (2 * trials)) / (1 + z * z / trials)
    half = z / (1 + z * z / trials) * math.sqrt(rate * (1 - rate) / trials + z * z / (4 * trials * trials))
    # At the ends the formula is exact and only rounding would leave 0 or 1.
    low = 0.0 if successes == 0 else max(0.0, shrunk - half)
    high = 1.0 if successes == trials else min(1.0, shrunk + half)
    return low, high


def paired_bootstrap(
    a: Float[np.ndarray, "n"],
    b: Float[np.ndarray, "n"],
    resamples: int = 10_000,
    confidence: float = 0.95,
    seed: int = 0,
) -> Difference:
    """The mean of a - b over pairs (the same worlds driven by two navigators), with a percentile bootstrap interval.

    Args:
        a: One navigator's figure in each world.
        b: The other's, in the same order.
        resamples: Samples drawn with replacement (B. Efron, Annals of Statistics 7, 1979).
        confidence: Of the interval.
        seed: Of the resampling.

    Raises:
        ValueError: when the two are not equally long vectors of finite numbers, or are empty.
    """
    a, b = np.asarray(a, np.float64), np.asarray(b, np.float64)
    require(a.ndim == 1 and a.shape == b.shape, "shapes of the pairs", (a.shape, b.shape), "two equally long vectors")
    require(len(a) > 0, "number of pairs", len(a), "at least 1")
    difference = a - b
    require(bool(np.isfinite(difference).all()), "pairs", "not finite", "finite numbers")
    means = _resampled_means(difference, resamples, np.random.default_rng(seed))
    return _difference(float(difference.mean()), means, confidence)


def unpaired_bootstrap(
    a: Float[np.ndarray, "n"],
    b: Float[np.ndarray, "m"],
    resamples: int = 10_000,
    confidence: float = 0.95,
    seed: int = 0,
) -> Difference:
    """The difference of the means of two separate samples, with its percentile bootstrap interval.

    Raises:
        ValueError: when one of them is empty or not finite.
    """
    a, b = np.asarray(a, np.float64), np.asarray(b, np.float64)
    for name, sample in (("a", a), ("b", b)):
        require(sample.ndim == 1 and len(sample) > 0, f"shape of {name}", sample.shape, "a vector, not empty")
        require(bool(np.isfinite(sample).all()), name, "not finite", "finite numbers")
    rng = np.random.default_rng(seed)
    means = _resampled_means(a, resamples, rng) - _resampled_means(b, resamples, rng)
    return _difference(float(a.mean() - b.mean()), means, confidence)


def _resampled_means(values: Float[np.ndarray, "n"], resamples: int, rng: np.random.Generator) -> np.ndarray:
    return np.array([values[rng.integers(len(values), size=len(values))].mean() for _ in range(resamples)])


def _difference(mean: float, means: np.ndarray, confidence: float) -> Difference:
    low, high = np.quantile(means, [(1 - confidence) / 2, (1 + confidence) / 2])
    return Difference(mean, float(low), float(high))
