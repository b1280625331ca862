"""Measurements of resets, and of the import and first step of a program."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from dataclasses import replace
from statistics import median

from rich.table import Table

from experiments.speed.runs import MIN_RUNS, Run, measure, timed
from experiments.speed.workload import Workload

IMPORT = "import mapf_pz"
FIRST_STEP = (
    "from mapf_pz import parallel_env; env = parallel_env(); env.reset(seed=0);"
    " env.step({agent: 0 for agent in env.agents})"
)
TIMED = "import time; start = time.perf_counter(); {code}; print(time.perf_counter() - start)"


def reset_table(workload: Workload, seconds: float) -> Table:
    """Measure resets: on the same map, on new maps, and with the cost to go."""
    settings = {
        "same map": replace(workload, new_maps=False, complete=False),
        "new map": workload.on_random_maps(new_maps=True, complete=False),
        "new map and cost to go": workload.on_random_maps(new_maps=True, complete=True),
    }
    workloads = {
        f"{number} agents, {name}": setting.with_env(num_agents=number)
        for number in (8, 64)
        for name, setting in settings.items()
    }
    table = Table(title="milliseconds per reset, medians of runs")
    table.add_column("")
    for heading in ("wall", "CPU"):
        table.add_column(heading, justify="right")
    for one in measure({name: reset_run(one) for name, one in workloads.items()}, seconds).values():
        table.add_row(one.name, f"{1e3 / one.rate:.3f}", f"{1e3 / one.cpu_rate:.3f}")
    return table


def reset_run(workload: Workload) -> Run:
    """Reset every environment; the counted events are resets."""
    simulator = workload.simulator()

    def play() -> int:
        simulator.reset()
        return workload.num_envs

    return timed(play)


def startup_table() -> Table:
    """Measure, in new processes, the import, and the first step with and without cached kernels."""
    table = Table(title="seconds in a new process")
    table.add_column("")
    table.add_column("wall", justify="right")
    table.add_row("import mapf_pz", f"{median(_seconds(IMPORT) for _ in range(MIN_RUNS)):.2f}")
    with tempfile.TemporaryDirectory() as folder:
        table.add_row("import and first step, compiling the kernels", f"{_seconds(FIRST_STEP, folder):.2f}")
        afterwards = median(_seconds(FIRST_STEP, folder) for _ in range(MIN_RUNS))
    table.add_row("import and first step afterwards", f"{afterwards:.2f}")
    return table


def _seconds(code: str, cache: str | None = None) -> float:
    """Return the runtime of `code` without the start of Python, with kernels cached in the folder `cache`."""
    environment = os.environ | ({} if cache is None else {"NUMBA_CACHE_DIR": cache})
    command = [sys.executable, "-c", TIMED.format(code=code)]
    process = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    return float(process.stdout)
