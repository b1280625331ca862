"""The instances of POGEMA's benchmark by name: `pogema-mazes`, `pogema-mazes-lifelong` and so on.

Each of the five sets is a pack. A one-shot instance has the starts of the lifelong one, and the first goals.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mapf_pz._internal.arrays import Ints, coordinates
from mapf_pz.instances.benchmarks.packs import read_arrays
from mapf_pz.instances.files.movingai import parse_cells
from mapf_pz.instances.files.pogema import BLOCKED, PASSABLE
from mapf_pz.instances.instance import Grid, Instance, Scenario

LIFELONG = "-lifelong"
"""Suffix of the names of lifelong instances."""
SETS = {
    "pogema-random": "01-random",
    "pogema-mazes": "02-mazes",
    "pogema-warehouse": "03-warehouse",
    "pogema-cities": "04-movingai",
    "pogema-puzzles": "05-puzzles",
}
"""The benchmark's own names of the packs."""

LIFELONG_STEPS = 256
"""Number of steps of lifelong episodes: a published throughput is a number of goals, divided by this."""
ONE_SHOT_UNITS = {"CSR": 1, "ISR": 1, "SoC": 1, "makespan": 1}
"""Published metrics of one-shot episodes, and what the packed numbers are divided by; `ISR`: the number of agents."""
ABSENT = -1
"""Packed number of a metric or instance that an episode does not state."""


@dataclass(frozen=True)
class PublishedResult:
    """A published episode."""

    algorithm: str
    """The algorithm's name."""
    instance: int
    """Number of the instance; -1 if it is not stated."""
    metrics: Mapping[str, float]
    """`CSR`, `ISR`, `SoC`, `makespan` and `avg_throughput`, as far as they were published."""


def is_bundled(name: str) -> bool:
    """Return whether there are bundled instances of this name."""
    return name.removesuffix(LIFELONG) in SETS


def instance_names() -> list[str]:
    """Return the names of the bundled instances."""
    return [name + suffix for name in SETS for suffix in ("", LIFELONG)]


def read_instances(name: str, num_agents: int | None = None) -> list[Instance]:
    """Return the instances of a name, with their first `num_agents` agents; None: all.

    Raises `ValueError` if the instances have fewer agents.
    """
    pack, lifelong = name.removesuffix(LIFELONG), name.endswith(LIFELONG)
    starts, counts, goals, maps = read_arrays(pack, "starts", "goal_counts", "goals", "maps")
    most = starts.shape[1]
    count = most if num_agents is None else num_agents
    if not 1 <= count <= most:
        raise ValueError(f"num_agents={count}: {name} has 1 to {most} agents")
    grids = read_grids(pack)
    ends = np.cumsum(counts.astype(np.int64)).reshape(counts.shape)
    begins = ends - counts
    found: list[Instance] = []
    for map, start, first, length in zip(maps, starts, begins[:, :count], counts[:, :count], strict=True):
        grid = grids[map]
        cells = _padded(goals, first, length) if lifelong else goals[first]
        width = grid.shape[1]
        agents = Scenario(
            coordinates(start[:count], width), coordinates(cells, width), length.astype(np.int32) if lifelong else None
        )
        found.append(Instance(grid, agents))
    return found


def instance_keys(name: str) -> list[tuple[str, str]]:
    """Return the map's name and the seed of each instance."""
    names, maps, seeds = read_arrays(name.removesuffix(LIFELONG), "map_names", "maps", "seeds")
    return [(str(names[map]), str(seed)) for map, seed in zip(maps, seeds, strict=True)]


def read_results(name: str, num_agents: int) -> list[PublishedResult]:
    """Return the published episodes with a number of agents on the instances of a name, by algorithm and instance."""
    pack, kind = name.removesuffix(LIFELONG), "lmapf" if name.endswith(LIFELONG) else "mapf"
    units = {"avg_throughput": LIFELONG_STEPS} if kind == "lmapf" else ONE_SHOT_UNITS | {"ISR": num_agents}
    columns = ("algorithms", "algorithm", "instance", "num_agents", *units)
    names, algorithms, instances, counts, *numbers = read_arrays(pack, *(f"{kind} {column}" for column in columns))
    results: list[PublishedResult] = []
    for row in np.flatnonzero(counts == num_agents).tolist():
        found = {metric: int(values[row]) for metric, values in zip(units, numbers, strict=True)}
        metrics = {metric: number / units[metric] for metric, number in found.items() if number != ABSENT}
        results.append(PublishedResult(str(names[algorithms[row]]), int(instances[row]), metrics))
    return results


def read_grids(pack: str) -> list[Grid]:
    """Return the maps of a pack."""
    names, shapes, cells = read_arrays(pack, "map_names", "map_shapes", "map_cells")
    grids: list[Grid] = []
    end = 0
    for name, (height, width) in zip(names.tolist(), shapes.tolist(), strict=True):
        rows = [cells[end + row * width : end + (row + 1) * width].tobytes().decode() for row in range(height)]
        grids.append(Grid(parse_cells(rows, width, name, 1, PASSABLE, BLOCKED), name))
        end += height * width
    return grids


def _padded(goals: Ints, first: Ints, counts: Ints) -> Ints:
    """Return the sequences (N, L) of goals, which start at `first` (N,); shorter ones are padded with their first."""
    steps = np.arange(counts.max())
    return goals[first[:, None] + np.where(steps < counts[:, None], steps, 0)]
