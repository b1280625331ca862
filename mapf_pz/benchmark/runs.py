"""Bouts: candidates take turns, so that a slow spell of the machine meets all of them."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from statistics import median
from typing import NamedTuple

MIN_RUNS = 5


class Played(NamedTuple):
    """What a candidate did in one run."""

    steps: int
    """Steps that agents took, or whatever else is counted."""
    wall: float
    """Seconds."""
    cpu: float
    """CPU seconds of all threads."""


Run = Callable[[], Played]
"""Plays once."""


def timed(play: Callable[[], int]) -> Run:
    """Make a run out of what returns how many steps agents took."""

    def run() -> Played:
        wall, cpu = time.perf_counter(), time.process_time()
        steps = play()
        # The processor's clock may tick so seldom that none of it passes.
        spent = max(time.process_time() - cpu, time.get_clock_info("process_time").resolution)
        return Played(steps, time.perf_counter() - wall, spent)

    return run


@dataclass(frozen=True)
class Measurement:
    """What came of a candidate's runs."""

    name: str
    """Who played."""
    rate: float
    """Agent steps per second, the median of all runs."""
    cpu_rate: float
    """Agent steps per CPU second of all threads, the median of all runs."""
    num_runs: int
    """How many runs."""


def measure(runs: Mapping[str, Run], seconds: float) -> dict[str, Measurement]:
    """Let all play in turns for about so many seconds in all, after one run each that does not count."""
    for play in runs.values():
        play()
    results: dict[str, list[Played]] = {name: [] for name in runs}
    began = time.perf_counter()
    num_rounds = 0
    while num_rounds < MIN_RUNS or time.perf_counter() - began < seconds:
        num_rounds += 1
        for name, play in runs.items():
            results[name].append(play())
    return {name: _summary(name, played) for name, played in results.items()}


def _summary(name: str, played: list[Played]) -> Measurement:
    return Measurement(
        name,
        rate=median(one.steps / one.wall for one in played),
        cpu_rate=median(one.steps / one.cpu for one in played),
        num_runs=len(played),
    )
