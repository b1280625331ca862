"""95 % confidence intervals of means."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

QUANTILE = 1.959964
"""The quantile 0.975 of the standard normal distribution."""


def interval(metric: str, values: Sequence[float]) -> tuple[float, float]:
    """Return the interval of the mean of a metric: Wilson's for `CSR`, which is 0 or 1, otherwise the bootstrap's."""
    return wilson(float(np.mean(values)), len(values)) if metric == "CSR" else bootstrap(values)


def bootstrap(values: ArrayLike, seed: int = 0, resamples: int = 2000) -> tuple[float, float]:
    """Return the bootstrap interval of the mean (Efron, 1979); that of equal values, or of one, has the length 0."""
    array = np.asarray(values, np.float64)
    means = np.random.default_rng(seed).choice(array, (resamples, len(array))).mean(axis=1)
    low, high = np.quantile(means, (0.025, 0.975))
    return float(low), float(high)


def wilson(share: float, count: int) -> tuple[float, float]:
    """Return the interval of a probability (Wilson, 1927), given the share of successes in `count` trials."""
    squared = QUANTILE**2
    center = (share + squared / (2 * count)) / (1 + squared / count)
    half = QUANTILE / (1 + squared / count) * np.sqrt(share * (1 - share) / count + squared / (4 * count**2))
    low = 0.0 if share == 0 else center - half
    high = 1.0 if share == 1 else center + half
    return float(low), float(high)
