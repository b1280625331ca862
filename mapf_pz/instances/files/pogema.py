"""Instances of POGEMA's benchmark, converted to JSON: one file with maps, and one with starts and goals.

Source: github.com/Cognitive-AI-Systems/pogema-benchmark. Coordinates are [row, col], although the keys say `xy`.
"""

from __future__ import annotations

from pathlib import Path
from reprlib import repr as shortened
from typing import Any

import numpy as np

from mapf_pz._internal.json import are_whole, list_member, parse_json, parse_object, text_member
from mapf_pz._internal.text import read_text
from mapf_pz.errors import FormatError
from mapf_pz.instances.files.movingai import parse_cells
from mapf_pz.instances.instance import Grid, Instance, Scenario

PASSABLE, BLOCKED = ".@$!", "#"
"""Characters of free cells (three of them mark where agents may start or end; all are passable), and of obstacles."""
MAX_GOALS = 16_000_000
"""Maximum number of goals in a file, with all sequences padded to the longest; larger files are rejected."""


def read_pogema(path: str | Path, num_agents: int | None = None) -> list[Instance]:
    """Read the instances of `SET.mapf.json` or `SET.lmapf.json`, whose maps are in `SET.maps.json` in the same folder.

    The first `num_agents` agents of each instance are used; None: as many as the smallest instance has. In lifelong
    instances, each agent has a sequence of goals; sequences may differ in length. The metric `exhausted_agents` counts
    the agents that reached the end of their sequence.

    Raises:
        FileNotFoundError: A file does not exist.
        FormatError: A file is malformed, or an instance has too few agents or does not fit its map.
        ValueError: `num_agents` is less than 1.
    """
    if num_agents is not None and num_agents < 1:
        raise ValueError(f"num_agents={num_agents}: expected a whole number, 1 or more")
    file = Path(path)
    maps_file = file.with_name(f"{file.name.split('.')[0]}.maps.json")
    maps = parse_object(read_text(maps_file), maps_file)
    grids = {name: _grid(name, rows, maps_file) for name, rows in maps.items()}
    entries = _entries(file)
    most_goals = MAX_GOALS // len(entries)
    named = [(entry, f"{file}: instance {number}") for number, entry in enumerate(entries)]
    count = num_agents or min(len(list_member(entry, "agents_xy", where, least=1)) for entry, where in named)
    return [_instance(entry, count, grids, most_goals, where) for entry, where in named]


def _entries(file: Path) -> list[Any]:
    entries = parse_json(read_text(file), file)
    if not isinstance(entries, list) or not entries:
        raise FormatError(file, f"expected a list of instances, got {shortened(entries)}", 1)
    for number, entry in enumerate(entries):
        if not isinstance(entry, dict):
            raise FormatError(f"{file}: instance {number}", f"expected an object, got {shortened(entry)}")
    return entries


def _grid(name: str, rows: Any, origin: Path) -> Grid:
    """Return a map; row numbers in messages start at 1."""
    where = f"{origin}: map {shortened(name)}"
    if not isinstance(rows, list) or not all(isinstance(row, str) for row in rows) or not any(rows):
        raise FormatError(where, f"expected rows of text, got {shortened(rows)}")
    return Grid(parse_cells(rows, max(map(len, rows)), where, 1, PASSABLE, BLOCKED), name)


def _instance(entry: dict[str, Any], num_agents: int, grids: dict[str, Grid], most_goals: int, where: str) -> Instance:
    """Return the instance of an entry; raises `FormatError` for more than `most_goals` goals."""
    name = text_member(entry, "map_name", where)
    if name not in grids:
        raise FormatError(where, f"expected the name of a map, got {shortened(name)}")
    starts = list_member(entry, "agents_xy", where, num_agents)[:num_agents]
    goals = list_member(entry, "targets_xy", where, num_agents)[:num_agents]
    counts = None
    if not all(map(_is_cell, starts)):
        raise FormatError(where, "expected 'agents_xy' to be [row, col] of each agent")
    if all(map(_is_sequence, goals)):
        longest = max(map(len, goals))
        if num_agents * longest > most_goals:
            raise FormatError(where, f"expected at most {most_goals} goals, got {num_agents} x {longest}")
        counts = np.array(list(map(len, goals)))
        goals = [sequence + sequence[:1] * (longest - len(sequence)) for sequence in goals]
    elif not all(map(_is_cell, goals)):
        raise FormatError(where, "expected 'targets_xy' to be [row, col] of each agent, or lists of them")
    try:
        return Instance(grids[name], Scenario(np.array(starts), np.array(goals), counts))
    except ValueError as error:
        raise FormatError(where, str(error)) from None


def _is_cell(item: Any) -> bool:
    return are_whole(item) and len(item) == 2


def _is_sequence(item: Any) -> bool:
    return isinstance(item, list) and len(item) > 0 and all(map(_is_cell, item))
