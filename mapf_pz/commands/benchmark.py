"""The command `mapf-pz benchmark`: measure the speed of environments."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from rich.console import Console
from rich.table import Table

from mapf_pz.speed.candidates import candidate_table
from mapf_pz.speed.peers import Peers
from mapf_pz.speed.scaling import scaling_table
from mapf_pz.speed.startup import reset_table, startup_table
from mapf_pz.speed.workload import Workload


@dataclass(frozen=True)
class BenchmarkOptions(Peers, Workload):
    """Options of `mapf-pz benchmark`."""

    tables: tuple[Literal["candidates", "scaling", "resets", "startup"], ...] = ("candidates",)
    """Tables to print. `candidates`: the interfaces of this package, a memory copy of the same observations, and other
    environments; `scaling`: the simulator with more agents, environments and threads, and larger views and maps;
    `resets`: resets of the environment; `startup`: the import and first step of a program."""
    seconds: float = 10.0
    """Duration of the measurement per table in seconds; there are at least five runs."""


TABLES: dict[str, Callable[[BenchmarkOptions], Table]] = {
    "candidates": lambda options: candidate_table(options, options, options.seconds),
    "scaling": lambda options: scaling_table(options, options.seconds),
    "resets": lambda options: reset_table(options, options.seconds),
    "startup": lambda _options: startup_table(),
}


def benchmark(options: BenchmarkOptions) -> None:
    """Measure the speed of environments with random actions, and print tables."""
    console = Console()
    for name in options.tables:
        console.print(TABLES[name](options))
