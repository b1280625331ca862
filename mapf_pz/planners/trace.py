"""The costs of the solutions that a planner finds over time."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import NamedTuple

from mapf_pz._internal.atomic import write_whole
from mapf_pz.planners.deadline import Clock


class Solution(NamedTuple):
    """A solution that was found."""

    seconds: float
    """Seconds since the start of the time limit, by the planner's clock."""
    sum_of_costs: int
    """Its sum of costs."""


class Trace:
    """The solutions of one plan in the order in which they were found, each with a lower sum of costs than before."""

    def __init__(self, clock: Clock) -> None:
        """Start the time now."""
        self._clock = clock
        self._start = clock()
        self.solutions: list[Solution] = []

    def add(self, sum_of_costs: int) -> None:
        """Add a solution that was found now, unless it is not better than the last one."""
        if not self.solutions or sum_of_costs < self.solutions[-1].sum_of_costs:
            self.solutions.append(Solution(self.seconds, sum_of_costs))

    @property
    def seconds(self) -> float:
        """Seconds since the start."""
        return self._clock() - self._start


def write_trace(trace: Trace, path: str | Path) -> None:
    """Write a CSV file with the columns `seconds` and `sum_of_costs`, and a row for each solution."""
    text = io.StringIO(newline="")
    rows = [(f"{seconds:.6f}", cost) for seconds, cost in trace.solutions]
    csv.writer(text, lineterminator="\n").writerows([Solution._fields, *rows])
    write_whole(Path(path), text.getvalue().encode())
