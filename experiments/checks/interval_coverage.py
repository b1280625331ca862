"""Simulate how often the intervals of means hold the true mean: `python -m experiments.checks.interval_coverage`.

For several distributions of values, it prints the coverage and the mean length of the 95 % intervals of this package,
of Student's, and of the percentile bootstrap's, by the number of episodes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import exp, inf

import numpy as np
import tyro
from scipy.special import stdtrit

from mapf_pz._internal.arrays import Floats
from mapf_pz.evaluation.reports.intervals import mean_interval

COUNTS = (8, 16, 32, 64, 128)
SHARES = (0.5, 0.8, 0.9, 0.95, 0.98)
Sample = Callable[[np.random.Generator, int], Floats]
Interval = Callable[[Floats], tuple[float, float]]


@dataclass(frozen=True)
class Values:
    """A distribution of the metric of an episode."""

    name: str
    """Description."""
    mean: float
    """The true mean."""
    sample: Sample
    """Samples values from a generator and their number."""
    least: float = -inf
    """Lower bound that the interval knows."""
    most: float = inf
    """Upper bound that the interval knows."""


def distributions() -> Iterator[Values]:
    """Yield distributions: ISR of 8 and 32 agents, throughputs with and without livelocks, and costs."""
    for p in SHARES:
        yield Values(f"ISR {p}, all agents or none", p, lambda rng, n, p=p: rng.binomial(1, p, n) * 1.0, 0, 1)
        for agents in (8, 32):
            yield Values(
                f"ISR {p}, {agents} independent agents",
                p,
                lambda rng, n, p=p, agents=agents: rng.binomial(agents, p, n) / agents,
                0,
                1,
            )
            yield Values(
                f"ISR {p}, {agents} agents, harder and easier episodes",
                p,
                lambda rng, n, p=p, agents=agents: rng.binomial(agents, rng.beta(2 * p, 2 - 2 * p, n)) / agents,
                0,
                1,
            )
    yield Values("throughput, normal", 2.0, lambda rng, n: rng.normal(2, 0.1, n), 0)
    for share in (0.05, 0.1, 0.3):
        yield Values(
            f"throughput, livelock in {share:.0%} of the episodes",
            2 - 1.7 * share,
            lambda rng, n, share=share: np.where(rng.random(n) < share, 0.3, 2) + rng.normal(0, 0.1, n),
            0,
        )
    yield Values("cost ratio, exponential above 1", 1.2, lambda rng, n: 1 + rng.exponential(0.2, n))
    for scale in (0.25, 0.5, 1.0):
        yield Values(
            f"cost, lognormal, {scale}", exp(scale**2 / 2), lambda rng, n, scale=scale: rng.lognormal(0, scale, n)
        )


def student(values: Floats) -> tuple[float, float]:
    """Return Student's interval."""
    half = float(stdtrit(len(values) - 1, 0.975)) * values.std(ddof=1) / len(values) ** 0.5
    return values.mean() - half, values.mean() + half


def percentile(values: Floats) -> tuple[float, float]:
    """Return the interval of the percentile bootstrap."""
    means = np.random.default_rng(0).choice(values, (1000, len(values))).mean(axis=1)
    low, high = np.quantile(means, (0.025, 0.975))
    return float(low), float(high)


def coverage(values: Values, count: int, interval: Interval, repetitions: int, seed: int) -> tuple[float, float]:
    """Return the share of repetitions whose interval holds the true mean, and the mean length of the intervals."""
    rng = np.random.default_rng(seed)
    ends = np.array([interval(values.sample(rng, count)) for _ in range(repetitions)])
    held = (ends[:, 0] <= values.mean + 1e-12) & (values.mean - 1e-12 <= ends[:, 1])
    return float(held.mean()), float((ends[:, 1] - ends[:, 0]).mean())


def main(repetitions: int = 1000, seed: int = 0) -> None:
    """Print the tables.

    Args:
        repetitions: Number of simulated evaluations for each number of episodes.
        seed: Random seed.
    """
    lowest: dict[str, float] = {}
    print(f"| values | interval | {' | '.join(map(str, COUNTS))} |\n| --- | --- |" + " --- |" * len(COUNTS))
    for values in distributions():
        methods: dict[str, Interval] = {
            "this package": lambda sample, values=values: mean_interval(sample, values.least, values.most),
            "Student": student,
            "bootstrap": percentile,
        }
        for name, method in methods.items():
            found = [coverage(values, count, method, repetitions, seed) for count in COUNTS]
            lowest[name] = min(lowest.get(name, 1.0), *(share for share, _ in found))
            cells = " | ".join(f"{share:.2f} ({length:.2g})" for share, length in found)
            print(f"| {values.name} | {name} | {cells} |", flush=True)
    print("lowest coverage:", ", ".join(f"{name} {share:.3f}" for name, share in lowest.items()))


if __name__ == "__main__":
    tyro.cli(main)
