"""Example problems of the League of Robot Runners 2023 by name: `warehouse_small_10`, `random_100` and so on."""

from __future__ import annotations

from functools import cache

import numpy as np

from mapf_pz._internal.arrays import coordinates, frozen
from mapf_pz.instances.benchmarks.packs import read_arrays
from mapf_pz.instances.bundled import map_path
from mapf_pz.instances.files.lorr import ROUND_ROBIN, LorrProblem
from mapf_pz.instances.files.movingai import read_map

PACK = "lorr-2023"


@cache
def problem_names() -> tuple[str, ...]:
    """Return the names of the bundled problems."""
    (names,) = read_arrays(PACK, "names")
    return tuple(names.tolist())


def read_problem(name: str) -> LorrProblem:
    """Return a bundled problem."""
    maps, tasks, starts = read_arrays(PACK, "maps", "tasks", f"starts {name}")
    number = problem_names().index(name)
    (errands,) = read_arrays(PACK, f"tasks {tasks[number]}")
    grid = read_map(map_path(str(maps[number])))
    return LorrProblem(
        grid=grid,
        starts=frozen(coordinates(starts, grid.shape[1]), np.int32),
        errands=frozen(coordinates(errands, grid.shape[1]), np.int32),
        offsets=frozen(np.arange(len(errands) + 1), np.int64),
        strategy=ROUND_ROBIN,
        version=None,
        name=name,
    )
