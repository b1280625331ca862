"""Instances of POGEMA's benchmark, converted to JSON: one file of maps, and one of starts and goals.

Source: github.com/Cognitive-AI-Systems/pogema-benchmark. Coordinates are [row, col], though their keys say `xy`.
"""

from __future__ import annotations

from pathlib import Path
from reprlib import repr as shortened
from typing import Any, TypeGuard

import numpy as np

from mapf_pz.instances.jsonfile import are_whole, list_member, parse_json, parse_object, text_member
from mapf_pz.instances.movingai import parse_cells
from mapf_pz.instances.textfile import read_text
from mapf_pz.types import FormatError, Grid, Instance, Scenario

PASSABLE, BLOCKED = ".@$!", "#"
"""Characters of free cells (three of them say who may start or end there, all may pass), and of obstacles."""


def load_pogema(path: str | Path, num_agents: int) -> list[Instance]:
    """Read the instances of a file `SET.mapf.json` or `SET.lmapf.json`, whose maps are in `SET.maps.json` beside it.

    Of each the first `num_agents` agents are taken. Lifelong instances, whose agents have goals one after the other, go
    round each agent's own sequence where another agent's is longer.

    Raises:
        FileNotFoundError: There is no such file.
        FormatError: A file is malformed, or an instance has fewer agents or does not fit its map.
    """
    file = Path(path)
    maps_file = file.with_name(f"{file.name.split('.')[0]}.maps.json")
    grids = {
        name: Grid(parse_cells(rows, len(rows[0]), f"{maps_file}: {name}", 1, PASSABLE, BLOCKED), name)
        for name, rows in parse_object(read_text(maps_file), maps_file).items()
        if _are_rows(rows, name, maps_file)
    }
    entries = parse_json(read_text(file), file)
    if not isinstance(entries, list) or not entries:
        raise FormatError(file, f"expected a list of instances, got {shortened(entries)}", 1)
    return [_instance(entry, number, num_agents, grids, file) for number, entry in enumerate(entries)]


def _are_rows(rows: Any, name: str, origin: Path) -> TypeGuard[list[str]]:
    if not isinstance(rows, list) or not rows or not all(isinstance(row, str) for row in rows):
        raise FormatError(origin, f"expected map {name!r} to be rows of text, got {shortened(rows)}")
    return True


def _instance(entry: Any, number: int, num_agents: int, grids: dict[str, Grid], origin: Path) -> Instance:
    where = f"{origin}: instance {number}"
    if not isinstance(entry, dict):
        raise FormatError(where, f"expected an object, got {shortened(entry)}")
    name = text_member(entry, "map_name", where)
    if name not in grids:
        raise FormatError(where, f"expected the name of a map, got {name!r}")
    starts = list_member(entry, "agents_xy", where, num_agents)[:num_agents]
    goals = list_member(entry, "targets_xy", where, num_agents)[:num_agents]
    if all(map(_is_sequence, goals)):
        longest = max(map(len, goals))
        goals = [[own[k % len(own)] for k in range(longest)] for own in goals]
    elif not all(map(_is_cell, goals)):
        raise FormatError(where, "expected 'targets_xy' to be [row, col] of each agent, or lists of them")
    if not all(map(_is_cell, starts)):
        raise FormatError(where, "expected 'agents_xy' to be [row, col] of each agent")
    try:
        return Instance(grids[name], Scenario(np.array(starts), np.array(goals)))
    except ValueError as error:
        raise FormatError(where, str(error)) from None


def _is_cell(item: Any) -> bool:
    return are_whole(item) and len(item) == 2


def _is_sequence(item: Any) -> bool:
    return isinstance(item, list) and len(item) > 0 and all(map(_is_cell, item))
