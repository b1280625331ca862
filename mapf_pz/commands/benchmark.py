"""The command `mapf-pz benchmark`: how fast environments step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from rich.console import Console
from rich.table import Table

from mapf_pz.benchmark.beginning import reset_table, startup_table
from mapf_pz.benchmark.contenders import contender_table
from mapf_pz.benchmark.load import Load
from mapf_pz.benchmark.scaling import scaling_table


@dataclass(frozen=True)
class BenchmarkOptions(Load):
    """What is stepped, and what is measured."""

    tables: tuple[Literal["contenders", "scaling", "resets", "startup"], ...] = ("contenders",)
    """`contenders`: our interfaces beside a memory copy of the same observations, and beside POGEMA; `scaling`: the
    simulator with more agents, environments and threads, larger views and maps; `resets`; `startup`: import and first
    step of a program."""
    seconds: float = 10.0
    """Length of the measurement for each table; five bouts are played in any case."""
    pogema: str | None = None
    """A Python in which POGEMA 1.4.0 is installed (`make bench-peers`); None leaves it out."""


TABLES: dict[str, Callable[[BenchmarkOptions], Table]] = {
    "contenders": lambda options: contender_table(options, options.pogema, options.seconds),
    "scaling": lambda options: scaling_table(options, options.seconds),
    "resets": lambda options: reset_table(options, options.seconds),
    "startup": lambda _options: startup_table(),
}


def benchmark(options: BenchmarkOptions) -> None:
    """Measure how fast environments step with random actions, and print tables."""
    console = Console()
    for name in options.tables:
        console.print(TABLES[name](options))
