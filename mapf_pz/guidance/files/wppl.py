"""WPPL's format: a JSON list of five numbers per cell, for moving east, south, west, north, and for waiting.

The number 100000 is a blocked edge. WPPL won the League of Robot Runners 2023. Source:
github.com/DiligentPanda/MAPF-LRR2023.
"""

from __future__ import annotations

import json
from pathlib import Path
from reprlib import repr as shortened

import numpy as np

from mapf_pz._internal.atomic import write_whole
from mapf_pz._internal.json import parse_json
from mapf_pz._internal.text import read_text
from mapf_pz.errors import FormatError
from mapf_pz.guidance.edges import open_edges
from mapf_pz.guidance.files.ggo_json import numbers
from mapf_pz.guidance.files.weights import as_numbers, checked_weights
from mapf_pz.guidance.graph import GuidanceGraph
from mapf_pz.instances.instance import Grid

BLOCKED_EDGE = 100_000
"""The weight of a blocked edge, and of waiting on an obstacle."""


def read(path: str | Path, grid: Grid | None) -> GuidanceGraph:
    """Read a guidance graph; raises as `load_guidance`. Weights of edges that the map does not have are ignored."""
    if grid is None:
        raise ValueError(f"{path}: a .w file does not contain the size of its map; expected the map, too")
    data = parse_json(read_text(path), path)
    expected = f"5 numbers for each cell of map {grid.name!r} ({grid.shape[0]} x {grid.shape[1]})"
    if not isinstance(data, list):
        raise FormatError(path, f"expected a list of {expected}, got {shortened(data)}")
    if len(data) != 5 * grid.free.size:
        raise FormatError(path, f"expected {5 * grid.free.size} numbers, {expected}, got {len(data)}")
    values = numbers(data, path).reshape(*grid.shape, 5)
    ignored = np.concatenate([~open_edges(grid.free), ~grid.free[None]]).transpose(1, 2, 0)
    blocked = values == BLOCKED_EDGE
    blocked[..., 4] = False
    weights = checked_weights(values.ravel(), (blocked | ignored).ravel(), path).reshape(values.shape)
    return GuidanceGraph(weights[..., :4].transpose(2, 0, 1), np.where(grid.free, weights[..., 4], 1))


def write(graph: GuidanceGraph, path: str | Path, grid: Grid) -> None:
    """Write a graph of the map `grid`; raises `ValueError` for finite weights of `BLOCKED_EDGE` or more."""
    wait = np.where(grid.free, graph.wait, np.float32(np.inf))
    weights = np.concatenate([graph.move, wait[None]]).transpose(1, 2, 0).ravel()
    too_large = np.isfinite(weights) & (weights >= BLOCKED_EDGE)
    if too_large.any():
        largest = weights[too_large].max()
        expected = f"expected weights less than {BLOCKED_EDGE}, which is a blocked edge in .w files"
        raise ValueError(f"{path}: {expected}, got {largest:g}")
    content = json.dumps(as_numbers(np.where(np.isinf(weights), np.float32(BLOCKED_EDGE), weights)))
    write_whole(Path(path), content.encode())
