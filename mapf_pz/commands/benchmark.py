"""The command `mapf-pz benchmark`: how fast environments step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from rich.console import Console
from rich.table import Table

from mapf_pz.benchmark.candidates import candidate_table
from mapf_pz.benchmark.scaling import scaling_table
from mapf_pz.benchmark.startup import reset_table, startup_table
from mapf_pz.benchmark.workload import Workload


@dataclass(frozen=True)
class BenchmarkOptions(Workload):
    """What is stepped, and what is measured."""

    tables: tuple[Literal["candidates", "scaling", "resets", "startup"], ...] = ("candidates",)
    """`candidates`: our interfaces beside a memory copy of the same observations, and beside POGEMA; `scaling`: the
    simulator with more agents, environments and threads, larger views and maps; `resets`; `startup`: import and first
    step of a program."""
    seconds: float = 10.0
    """Length of the measurement for each table; five runs are played in any case."""
    pogema: str | None = None
    """A Python in which POGEMA 1.4.0 is installed (`make bench-peers`); None leaves it out."""


TABLES: dict[str, Callable[[BenchmarkOptions], Table]] = {
    "candidates": lambda options: candidate_table(options, options.pogema, options.seconds),
    "scaling": lambda options: scaling_table(options, options.seconds),
    "resets": lambda options: reset_table(options, options.seconds),
    "startup": lambda _options: startup_table(),
}


def benchmark(options: BenchmarkOptions) -> None:
    """Measure how fast environments step with random actions, and print tables."""
    console = Console()
    for name in options.tables:
        console.print(TABLES[name](options))
