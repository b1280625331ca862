"""Write the packs of bundled benchmarks from the public data: `python -m experiments.data.benchmark_packs --help`.

The sources and their commits are in `mapf_pz/instances/benchmarks/README.md`. The same data gives the same bytes.
"""

from __future__ import annotations

import csv
import io
import json
import zipfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from numpy.typing import ArrayLike

from mapf_pz._internal.arrays import Ints
from mapf_pz.instances import load_map, read_problem, read_scenario
from mapf_pz.instances.benchmarks.movingai import NUM_SCENARIOS, PACK
from mapf_pz.instances.benchmarks.pogema import ABSENT, LIFELONG_STEPS, ONE_SHOT_UNITS, SETS

SCENARIO_MAPS = (
    *("Berlin_1_256", "Paris_1_256", "den312d", "ost003d", "maze-32-32-4", "room-32-32-4", "room-64-64-16"),
    *("empty-8-8", "empty-16-16", "empty-32-32", "empty-48-48", "random-32-32-10", "random-32-32-20"),
    *("random-64-64-10", "warehouse-10-20-10-2-1", "warehouse-10-20-10-2-2", "warehouse-20-40-10-2-2"),
)
"""Maps of the MovingAI benchmark whose scenarios are packed."""
PROBLEMS = (
    *(("warehouse.domain", f"warehouse_small_{size}") for size in (10, 50, 60, 100, 200, 400, 800)),
    *(("random.domain", f"random_{size}") for size in (20, 50, 100, 200, 400, 600, 800)),
)
"""Folders and names of the packed problems of the League of Robot Runners."""


@dataclass(frozen=True)
class Sources:
    """Folders of public data; packs whose folder is not given are not written."""

    output: Path = Path("mapf_pz/instances/benchmarks")
    """Folder of the packs."""
    movingai: Path | None = None
    """Folder with the scenarios of the MovingAI benchmark, `MAP-random-NUMBER.scen`."""
    lorr: Path | None = None
    """Folder `example_problems` of the Start-Kit of the League of Robot Runners, at the commit in the README."""
    pogema: Path | None = None
    """Folder with `SET.maps.json`, `SET.lmapf.json` and `SET.results*.csv` of POGEMA's benchmark: instances as of
    `mapf-pz maps convert`, and a row for each published episode."""


def write_packs(sources: Sources) -> None:
    """Write the packs of the given sources."""
    if sources.movingai is not None:
        write(sources.output / f"{PACK}.npz", movingai(sources.movingai))
    if sources.lorr is not None:
        write(sources.output / "lorr-2023.npz", lorr(sources.lorr))
    if sources.pogema is not None:
        for pack, name in SETS.items():
            write(sources.output / f"{pack}.npz", pogema(sources.pogema, name))


def write(file: Path, arrays: Mapping[str, ArrayLike]) -> None:
    """Write arrays to a `.npz` file, each compressed by LZMA; the bytes depend only on the arrays."""
    with zipfile.ZipFile(file, "w", zipfile.ZIP_LZMA) as archive:
        for name, values in arrays.items():
            content = io.BytesIO()
            np.lib.format.write_array(content, np.asarray(values), allow_pickle=False)
            archive.writestr(zipfile.ZipInfo(f"{name}.npy"), content.getvalue(), zipfile.ZIP_LZMA)
    print(f"{file}: {file.stat().st_size} bytes")


def movingai(folder: Path) -> dict[str, Ints]:
    """Return the start and goal cells of each map's scenarios: (10, M, 2)."""
    packed: dict[str, Ints] = {}
    for name in SCENARIO_MAPS:
        grid = load_map(name)
        scenarios = [read_scenario(folder / f"{name}-random-{n}.scen", grid) for n in range(1, NUM_SCENARIOS + 1)]
        width = grid.shape[1]
        packed[name] = np.array(
            [np.stack([_cells(one.starts, width), _cells(one.goals, width)], 1) for one in scenarios]
        )
    return packed


def lorr(folder: Path) -> dict[str, ArrayLike]:
    """Return the problems' names, maps and lists of tasks by name, their start cells, and the cells of the lists."""
    maps: list[str] = []
    tasks: list[str] = []
    cells: dict[str, ArrayLike] = {}
    for domain, name in PROBLEMS:
        file = folder / domain / f"{name}.json"
        problem, data = read_problem(file), json.loads(file.read_text("utf-8"))
        width = problem.grid.shape[1]
        if not np.array_equal(problem.grid.free, load_map(problem.grid.name).free):
            raise ValueError(f"{file}: the map {problem.grid.name} is not the bundled one")
        maps.append(problem.grid.name)
        tasks.append(Path(data["taskFile"]).stem)
        cells[f"starts {name}"] = _cells(problem.starts, width)
        cells[f"tasks {tasks[-1]}"] = _cells(problem.errands, width)
    return {"names": [name for _, name in PROBLEMS], "maps": maps, "tasks": tasks, **cells}


def pogema(folder: Path, name: str) -> dict[str, ArrayLike]:
    """Return the maps, lifelong instances and published results of a set of POGEMA's benchmark."""
    maps: dict[str, list[str]] = json.loads((folder / f"{name}.maps.json").read_text("utf-8"))
    entries: list[dict[str, Any]] = json.loads((folder / f"{name}.lmapf.json").read_text("utf-8"))
    names = list(maps)
    packed: dict[str, ArrayLike] = {
        "map_names": names,
        "map_shapes": np.array([(len(rows), len(rows[0])) for rows in maps.values()], np.uint16),
        "map_cells": np.frombuffer("".join(row for rows in maps.values() for row in rows).encode(), np.uint8),
        "maps": np.array([names.index(entry["map_name"]) for entry in entries], np.uint16),
        "seeds": np.array([entry["seed"] for entry in entries], np.uint16),
    }
    widths = [len(maps[entry["map_name"]][0]) for entry in entries]
    pairs = list(zip(entries, widths, strict=True))
    packed["starts"] = np.array([_cells(np.array(entry["agents_xy"]), width) for entry, width in pairs])
    packed["goal_counts"] = np.array([[len(goals) for goals in entry["targets_xy"]] for entry in entries], np.uint16)
    packed["goals"] = np.concatenate(
        [_cells(np.array(goals), width) for entry, width in pairs for goals in entry["targets_xy"]]
    )
    rows = [row for file in sorted(folder.glob(f"{name}.results*.csv")) for row in _rows(file)]
    keys = {(entry["map_name"], str(entry["seed"])): number for number, entry in enumerate(entries)}
    for kind in ("mapf", "lmapf"):
        packed |= {f"{kind} {column}": values for column, values in _results(rows, kind, keys).items()}
    return packed


def _cells(coordinates: Ints, width: int) -> Ints:
    """Return the cell numbers of [row, col] (M, 2)."""
    return (coordinates @ np.array([width, 1])).astype(np.uint16)


def _rows(file: Path) -> list[dict[str, str]]:
    with file.open(newline="", encoding="utf-8") as lines:
        return list(csv.DictReader(lines))


def _results(rows: Iterable[Mapping[str, str]], kind: str, keys: Mapping[tuple[str, str], int]) -> dict[str, ArrayLike]:
    """Return the columns of the published episodes of a kind, in the order of algorithm, number of agents and instance.

    An episode without a seed has no instance.
    """
    chosen = [row for row in rows if row["kind"] == kind]
    algorithms = list(dict.fromkeys(row["algorithm"] for row in chosen))
    episodes = [
        (
            algorithms.index(row["algorithm"]),
            int(row["num_agents"]),
            keys[row["map_name"], row["seed"]] if row["seed"] else ABSENT,
            row,
        )
        for row in chosen
    ]
    episodes.sort(key=lambda episode: episode[:3])
    columns: dict[str, ArrayLike] = {
        "algorithms": algorithms,
        "algorithm": np.array([episode[0] for episode in episodes], np.uint8),
        "num_agents": np.array([episode[1] for episode in episodes], np.uint16),
        "instance": np.array([episode[2] for episode in episodes], np.int16),
    }
    for name in ONE_SHOT_UNITS if kind == "mapf" else ("avg_throughput",):
        columns[name] = np.array([_count(row, name) for *_, row in episodes], np.int32)
    return columns


def _count(row: Mapping[str, str], name: str) -> int:
    """Return a metric as a whole number, or `ABSENT`; raises `ValueError` if it is none."""
    if not row[name]:
        return ABSENT
    factors = {"avg_throughput": LIFELONG_STEPS, "ISR": int(row["num_agents"])}
    value = float(row[name]) * factors.get(name, 1)
    if abs(value - round(value)) > 1e-3:  # some sources state six digits
        raise ValueError(f"{name} of {row['algorithm']}: expected a whole number, got {value}")
    return round(value)


if __name__ == "__main__":
    write_packs(tyro.cli(Sources, description=__doc__))
