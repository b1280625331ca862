"""Environments with random actions: the interfaces of this package, its simulator, and other environments."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from rich.console import Console
from rich.table import Table

from experiments.speed.candidates import candidate_table
from experiments.speed.peers import Peers
from experiments.speed.scaling import scaling_table
from experiments.speed.startup import reset_table, startup_table
from experiments.speed.workload import Workload


@dataclass(frozen=True)
class Options(Peers, Workload):
    """What is measured."""

    tables: tuple[Literal["candidates", "scaling", "resets", "startup"], ...] = ("candidates",)
    """Tables to print. `candidates`: the interfaces of this package, a memory copy of the same observations, and other
    environments; `scaling`: the simulator with more agents, environments and threads, and larger views and maps;
    `resets`: resets of the environment; `startup`: the import and first step of a program."""
    seconds: float = 10.0
    """Duration of the measurement per table in seconds; there are at least five runs."""


TABLES: dict[str, Callable[[Options], Table]] = {
    "candidates": lambda options: candidate_table(options, options, options.seconds),
    "scaling": lambda options: scaling_table(options, options.seconds),
    "resets": lambda options: reset_table(options, options.seconds),
    "startup": lambda _options: startup_table(),
}


def main(options: Options) -> None:
    """Measure the speed of environments with random actions, and print tables."""
    console = Console()
    for name in options.tables:
        console.print(TABLES[name](options))
