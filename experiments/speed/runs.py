"""Alternating runs of candidates, so that changes in the machine's speed affect all of them."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from statistics import median
from typing import NamedTuple

MIN_RUNS = 5


class Timing(NamedTuple):
    """The measurement of one run."""

    steps: int
    """Number of agent steps, or of other counted events."""
    wall: float
    """Wall-clock time in seconds."""
    cpu: float
    """CPU time of all threads in seconds."""
    observation: int | None = None
    """Bytes that each agent observes per step; None: nothing is observed."""


Run = Callable[[], Timing]
"""A function that runs a candidate once."""


def timed(play: Callable[[], int], observation: int | None = None) -> Run:
    """Return a run that measures a function, which returns its number of agent steps; `observation` as in `Timing`."""

    def run() -> Timing:
        wall, cpu = time.perf_counter(), time.process_time()
        steps = play()
        # The CPU clock may be so coarse that it does not advance.
        spent = max(time.process_time() - cpu, time.get_clock_info("process_time").resolution)
        return Timing(steps, time.perf_counter() - wall, spent, observation)

    return run


@dataclass(frozen=True)
class Measurement:
    """Summary of a candidate's runs."""

    name: str
    """Name of the candidate."""
    rate: float
    """Median of the agent steps per second."""
    cpu_rate: float
    """Median of the agent steps per CPU second of all threads."""
    num_runs: int
    """Number of runs."""
    observation: int | None = None
    """Bytes that each agent observes per step; None: nothing is observed."""


def measure(runs: Mapping[str, Run], seconds: float = 0.0, min_runs: int = MIN_RUNS) -> dict[str, Measurement]:
    """Alternate between all runs for about `seconds`, at least `min_runs` rounds, after one unmeasured run each."""
    for play in runs.values():
        play()
    results: dict[str, list[Timing]] = {name: [] for name in runs}
    start = time.perf_counter()
    num_rounds = 0
    while num_rounds < min_runs or time.perf_counter() - start < seconds:
        num_rounds += 1
        for name, play in runs.items():
            results[name].append(play())
    return {name: _summary(name, measured) for name, measured in results.items()}


def _summary(name: str, runs: list[Timing]) -> Measurement:
    return Measurement(
        name,
        rate=median(run.steps / run.wall for run in runs),
        cpu_rate=median(run.steps / run.cpu for run in runs),
        num_runs=len(runs),
        observation=runs[0].observation,
    )
