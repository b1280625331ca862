"""Beginnings: what a reset takes, and the first step of a program."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from dataclasses import replace
from statistics import median

from rich.table import Table

from mapf_pz.benchmark.runs import MIN_RUNS, Run, measure, timed
from mapf_pz.benchmark.workload import Workload

IMPORT = "import mapf_pz"
FIRST_STEP = (
    "from mapf_pz import parallel_env; env = parallel_env(); env.reset(seed=0);"
    " env.step({agent: 0 for agent in env.agents})"
)
TIMED = "import time; began = time.perf_counter(); {code}; print(time.perf_counter() - began)"


def reset_table(workload: Workload, seconds: float) -> Table:
    """Measure what a reset takes: on the map as it was, on new ones, and with the cost to go."""
    settings = {
        "same map": replace(workload, new_maps=False, complete=False),
        "new map": replace(workload, map=None, new_maps=True, complete=False),
        "new map and cost to go": replace(workload, map=None, new_maps=True, complete=True),
    }
    loads = {
        f"{number} agents, {name}": replace(setting, num_agents=number)
        for number in (8, 64)
        for name, setting in settings.items()
    }
    table = Table(title="milliseconds for each reset, medians of runs")
    table.add_column("")
    for heading in ("wall", "CPU"):
        table.add_column(heading, justify="right")
    for one in measure({name: reset_run(one) for name, one in loads.items()}, seconds).values():
        table.add_row(one.name, f"{1e3 / one.rate:.3f}", f"{1e3 / one.cpu_rate:.3f}")
    return table


def reset_run(workload: Workload) -> Run:
    """Begin a new episode in every environment; resets are counted."""
    simulator = workload.simulator()

    def play() -> int:
        simulator.reset()
        return workload.num_envs

    return timed(play)


def startup_table() -> Table:
    """Measure, in fresh processes, the import, and the first step with and without kernels compiled beforehand."""
    table = Table(title="seconds in a fresh process")
    table.add_column("")
    table.add_column("wall", justify="right")
    table.add_row("import mapf_pz", f"{median(_seconds(IMPORT) for _ in range(MIN_RUNS)):.2f}")
    with tempfile.TemporaryDirectory() as folder:
        table.add_row("import and first step, compiling the kernels", f"{_seconds(FIRST_STEP, folder):.2f}")
        afterwards = median(_seconds(FIRST_STEP, folder) for _ in range(MIN_RUNS))
    table.add_row("import and first step afterwards", f"{afterwards:.2f}")
    return table


def _seconds(code: str, cache: str | None = None) -> float:
    """Return how long it takes to run `code`, without the start of Python, with kernels kept in the folder `cache`."""
    environment = os.environ | ({} if cache is None else {"NUMBA_CACHE_DIR": cache})
    command = [sys.executable, "-c", TIMED.format(code=code)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    return float(done.stdout)
