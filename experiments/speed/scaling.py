"""Scaling: the time per agent step as the workload grows along several axes."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace

from rich.table import Table

from experiments.speed.candidates import copy_run, simulator_run
from experiments.speed.runs import Measurement, measure
from experiments.speed.workload import Workload

CELLS_PER_AGENT = 16


def more_agents(workload: Workload) -> dict[str, Workload]:
    """Return workloads with increasing numbers of agents and map sizes, and the same total number of agents."""
    total = max(workload.num_envs * workload.num_agents, 4096)
    workloads = {}
    for num_agents in (16, 64, 256, 1024, 4096):
        side = int((CELLS_PER_AGENT * num_agents) ** 0.5)
        larger = workload.on_random_maps(height=side, width=side, num_envs=total // num_agents)
        workloads[f"{num_agents} agents on {side} x {side}"] = larger.with_env(num_agents=num_agents)
    return workloads


def more_environments(workload: Workload) -> dict[str, Workload]:
    """Return workloads with increasing numbers of environments."""
    return {f"{number} environments": replace(workload, num_envs=number) for number in (1, 8, 64, 512)}


def larger_views(workload: Workload) -> dict[str, Workload]:
    """Return workloads with increasing view sizes."""
    return {f"views of {side} x {side}": workload.with_env(view_size=(side, side)) for side in (5, 7, 11, 20)}


def larger_maps(workload: Workload) -> dict[str, Workload]:
    """Return workloads with increasing map sizes."""
    sides = (32, 64, 128, 256)
    return {f"maps of {side} x {side}": workload.on_random_maps(height=side, width=side) for side in sides}


def more_threads(workload: Workload) -> dict[str, Workload]:
    """Return workloads with increasing numbers of threads, up to the number of processors."""
    count = os.cpu_count() or 1
    numbers = sorted({min(2**k, count) for k in range(count.bit_length() + 1)})
    return {f"{number} threads": replace(workload, num_threads=number) for number in numbers}


AXES: tuple[Callable[[Workload], dict[str, Workload]], ...] = (
    more_agents,
    more_environments,
    larger_views,
    larger_maps,
    more_threads,
)


def scaling_table(workload: Workload, seconds: float) -> Table:
    """Measure the simulator along every axis: a row per workload, a section per axis."""
    table = Table(title="time of the simulator per agent step, medians of runs")
    table.add_column("")
    for heading in ("ns", "x first", "CPU ns", "x copy"):
        table.add_column(heading, justify="right")
    for axis in AXES:
        workloads = axis(workload)
        runs = {name: simulator_run(one) for name, one in workloads.items()}
        copies = {_copy_of(name): copy_run(one) for name, one in workloads.items()}
        _add_rows(table, list(workloads), measure(runs | copies, seconds / len(AXES)))
    return table


def _add_rows(table: Table, names: list[str], measured: dict[str, Measurement]) -> None:
    first = measured[names[0]]
    for name in names:
        one, copy = measured[name], measured[_copy_of(name)]
        ratios = first.rate / one.rate, copy.cpu_rate / one.cpu_rate
        table.add_row(
            name, f"{1e9 / one.rate:.0f}", f"{ratios[0]:.2f}", f"{1e9 / one.cpu_rate:.0f}", f"{ratios[1]:.1f}"
        )
    table.add_section()


def _copy_of(name: str) -> str:
    return f"copy of {name}"
