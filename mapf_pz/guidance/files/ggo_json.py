"""GGO's JSON format: the map and a list of weights.

The list starts with the costs of waiting: one per free cell if `optimize_wait` is true, otherwise a single one. Then
follow, for each free cell in reading order, the weights of the moves that the map allows, in the order right, up, left,
down; -1 is a blocked edge. Source: github.com/lunjohnzhang/ggo_public.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from reprlib import repr as shortened
from typing import Any

import numpy as np

from mapf_pz._internal.arrays import Floats
from mapf_pz._internal.atomic import write_whole
from mapf_pz._internal.json import list_member, parse_object
from mapf_pz._internal.text import read_text
from mapf_pz.errors import FormatError
from mapf_pz.guidance.edges import open_edges
from mapf_pz.guidance.files.weights import GGO_HEADINGS, as_numbers, check_map, checked_weights
from mapf_pz.guidance.graph import GuidanceGraph
from mapf_pz.instances.files.layout import PASSABLE, cells_of, layout_rows
from mapf_pz.instances.instance import Grid

BLOCKED_EDGE = -1
"""The weight of a blocked edge."""


def read(path: str | Path, grid: Grid | None) -> GuidanceGraph:
    """Read a guidance graph; raises as `load_guidance`."""
    data = parse_object(read_text(path), path)
    free = cells_of(layout_rows(data, path), PASSABLE)
    check_map(free, grid, path)
    per_cell = data.get("optimize_wait", False)
    if not isinstance(per_cell, bool):
        raise FormatError(path, f"expected 'optimize_wait' to be true or false, got {shortened(per_cell)}")
    values = numbers(list_member(data, "weights", path), path)
    edges = open_edges(free)[GGO_HEADINGS].transpose(1, 2, 0)
    num_waits, num_moves = int(free.sum()) if per_cell else 1, int(edges.sum())
    if len(values) != num_waits + num_moves:
        expected = f"expected {num_waits + num_moves} numbers in 'weights', {num_waits} of them for waiting"
        raise FormatError(path, f"{expected}, got {len(values)}")
    blocked = (values == BLOCKED_EDGE) & (np.arange(len(values)) >= num_waits)
    weights = checked_weights(values, blocked, path)
    wait, move = np.ones(free.shape), np.full(edges.shape, np.inf)
    wait[free] = weights[:num_waits]
    move[edges] = weights[num_waits:]
    return GuidanceGraph(move.transpose(2, 0, 1)[GGO_HEADINGS], wait)


def write(graph: GuidanceGraph, path: str | Path, grid: Grid) -> None:
    """Write a graph of the map `grid`. A single cost of waiting is written if it is the same on all free cells."""
    waits = graph.wait[grid.free]
    per_cell = len(set(waits.tolist())) > 1
    edges = open_edges(grid.free)[GGO_HEADINGS].transpose(1, 2, 0)
    moves = graph.move[GGO_HEADINGS].transpose(1, 2, 0)[edges]
    # A map without free cells has no cost of waiting, but the format has one.
    first = waits if per_cell else waits[:1] if len(waits) else np.ones(1, np.float32)
    weights = np.concatenate([first, np.where(np.isfinite(moves), moves, np.float32(BLOCKED_EDGE))])
    data = {
        "name": grid.name,
        "layout": ["".join(row) for row in np.where(grid.free, ".", "@").tolist()],
        "weight": True,
        "optimize_wait": per_cell,
        "n_row": grid.shape[0],
        "n_col": grid.shape[1],
        "weights": as_numbers(weights),
    }
    write_whole(Path(path), json.dumps(data, indent=1).encode())


def numbers(values: list[Any], path: str | Path) -> Floats:
    """Return a list from JSON as float64; raises `FormatError` unless all items are numbers."""
    for number, value in enumerate(values):
        if type(value) not in (int, float) or abs(value) > sys.float_info.max:
            raise FormatError(path, f"expected a number as weight {number}, got {shortened(value)}")
    return np.array(values, np.float64)
