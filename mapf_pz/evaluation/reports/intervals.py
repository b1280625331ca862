"""95 % confidence intervals of means.

`experiments/checks/interval_coverage.py` measures how often they hold the true mean, from 8 episodes on.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import stdtrit

from mapf_pz._internal.arrays import Floats

QUANTILE = 1.959964
"""The quantile 0.975 of the standard normal distribution."""
LEVELS = 0.025, 0.975
RESAMPLES = 2000
BOUNDS = {
    "ISR": (0.0, 1.0),
    "collisions": (0.0, 1.0),
    "delay_share": (0.0, 1.0),
    "avg_throughput": (0.0, math.inf),
    "best_ratio": (0.0, math.inf),
}
"""Bounds of metrics of which a few episodes can be far from all others, such as lifelong episodes with a livelock."""
_RATIOS = ("SoC_ratio", "weighted_cost_ratio", "delayed_SoC_ratio")
LEAST: dict[str, float] = {f"{name} (solved)": 1.0 for name in _RATIOS}
"""Smallest possible values of metrics, if they are not 0; those of solved episodes are at least their lower bounds."""
TIMES = ("runtime", "step_ms", "agent_us")
"""Metrics without intervals: they vary with the machine and its load, of which episodes are no sample."""
FEWEST_RESAMPLED = 8
"""Minimum number of values for the studentized bootstrap; with fewer, resamples of almost equal values determine it."""
UNBOUNDED = -math.inf, math.inf
BOUND_WEIGHT = 0.5
"""Weight of a bound beside the weights of 1 of the values."""


def bounds_of(metric: str) -> tuple[float, float]:
    """Return the bounds of a metric, none of which is negative."""
    return (0.0, 1.0) if metric == "CSR" else BOUNDS.get(metric, (LEAST.get(metric, 0.0), math.inf))


def interval(metric: str, values: Sequence[float]) -> tuple[float, float]:
    """Return the interval of the mean of a metric: Wilson's for `CSR`, which is 0 or 1, otherwise `mean_interval`.

    That of `TIMES` has length 0.
    """
    mean = float(np.mean(values))
    if metric == "CSR":
        return wilson(mean, len(values))
    if metric in TIMES:
        return mean, mean
    low, high = mean_interval(values, *BOUNDS.get(metric, UNBOUNDED))
    return max(low, bounds_of(metric)[0]), high


def difference_interval(metric: str, differences: Sequence[float]) -> tuple[float, float]:
    """Return the interval of the mean difference of a metric between two policies in the same episodes."""
    if metric in TIMES:
        mean = float(np.mean(differences))
        return mean, mean
    low, high = (0.0, 1.0) if metric == "CSR" else BOUNDS.get(metric, UNBOUNDED)
    return mean_interval(differences, low - high, high - low)


def mean_interval(values: ArrayLike, least: float = -math.inf, most: float = math.inf) -> tuple[float, float]:
    """Return the interval of the mean of values from `least` to `most`.

    At the side of a finite bound, its end is a quantile of weighted means of the values and the bound, with random
    weights: those of the Bayesian bootstrap (Rubin, 1981), in which the bound stands for values that are not in the
    sample (Gaffke, *Three test statistics for a nonparametric one-sided hypothesis on the mean of a nonnegative
    variable*, 2005, whose bound has the weight 1 in place of `BOUND_WEIGHT`). At the side of an infinite bound it is
    Student's, or from `FEWEST_RESAMPLED` values on the outer one of Student's and of the studentized bootstrap's
    (Efron, 1982); it is the mean if all values are equal. One value has an interval of length 0, unless both bounds are
    finite.
    """
    array = np.asarray(values, np.float64)
    rng = np.random.default_rng(0)
    if math.isfinite(least) and math.isfinite(most):
        low, high = least, most
    else:
        low, high = _studentized(array, rng)
        if len(array) == 1:
            return low, high
    if math.isfinite(least):
        low = least + float(np.quantile(_weighted_means(array - least, rng), LEVELS[0]))
    if math.isfinite(most):
        high = most - float(np.quantile(_weighted_means(most - array, rng), LEVELS[0]))
    return low, high


def wilson(share: float, count: int) -> tuple[float, float]:
    """Return the interval of a probability (Wilson, 1927), given the share of successes in `count` trials."""
    squared = QUANTILE**2
    center = (share + squared / (2 * count)) / (1 + squared / count)
    half = QUANTILE / (1 + squared / count) * np.sqrt(share * (1 - share) / count + squared / (4 * count**2))
    low = 0.0 if share == 0 else center - half
    high = 1.0 if share == 1 else center + half
    return float(low), float(high)


def _weighted_means(values: Floats, rng: np.random.Generator) -> Floats:
    """Return means (RESAMPLES,) of the values (n,) and of the bound 0, weighted at random."""
    weights = rng.standard_exponential((RESAMPLES, len(values)))
    weight = rng.standard_gamma(BOUND_WEIGHT, RESAMPLES)
    return (weights @ values) / (weights.sum(axis=1) + weight)


def _studentized(values: Floats, rng: np.random.Generator) -> tuple[float, float]:
    """Return the outer interval of Student's and of the studentized bootstrap's; Student's for few values."""
    count, mean = len(values), float(values.mean())
    if count < 2 or not np.ptp(values):
        return mean, mean
    error = float(values.std(ddof=1)) / math.sqrt(count)
    student = float(stdtrit(count - 1, LEVELS[1]))
    if count < FEWEST_RESAMPLED:
        return mean - error * student, mean + error * student
    resampled = rng.choice(values, (RESAMPLES, count))
    errors = resampled.std(axis=1, ddof=1) / math.sqrt(count)
    usable = errors > 1e-9 * error  # not those of one value only
    quantiles = np.quantile((resampled.mean(axis=1) - mean)[usable] / errors[usable], LEVELS)
    return mean - error * max(student, float(quantiles[1])), mean + error * max(student, -float(quantiles[0]))
