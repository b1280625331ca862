"""GGO's table of weights: a row for each cell, in which x is the row, y the column, and `inf` a blocked edge.

Source: github.com/lunjohnzhang/ggo_public.
"""

from __future__ import annotations

import io
import re
from array import array
from pathlib import Path
from reprlib import repr as shortened

import numpy as np

from mapf_pz._internal.arrays import Bools, Floats
from mapf_pz._internal.atomic import write_whole
from mapf_pz._internal.text import read_text
from mapf_pz.errors import FormatError
from mapf_pz.guidance.edges import open_edges
from mapf_pz.guidance.files.weights import GGO_HEADINGS, as_numbers, check_map, checked_weights
from mapf_pz.guidance.graph import GuidanceGraph
from mapf_pz.instances.files.layout import BLOCKED, PASSABLE
from mapf_pz.instances.instance import Grid

HEADER = "id,type,x,y,weight_to_RIGHT,weight_to_UP,weight_to_LEFT,weight_to_DOWN,weight_for_WAIT"
"""The first line."""
_INDEX, _NUMBER = r"(\d{1,9})", r"(inf|\d{1,100}(?:\.\d{1,100})?(?:[eE][-+]?\d{1,4})?)"
_CELL = re.compile(",".join([_INDEX, f"([{PASSABLE}{BLOCKED}])", _INDEX, _INDEX, *[_NUMBER] * 5]), re.ASCII)


def read(path: str | Path, grid: Grid | None) -> GuidanceGraph:
    """Read a guidance graph; raises as `load_guidance`."""
    free, values, blocked = _parse(read_text(path), path)
    check_map(free, grid, path)
    edges = open_edges(free)[GGO_HEADINGS].transpose(1, 2, 0).reshape(-1, 4)
    needed = np.concatenate([np.zeros_like(edges), free.reshape(-1, 1)], axis=1)
    extra = ~edges & ~blocked[:, :4]
    if extra.any():
        line = 2 + int(np.argmax(extra.any(axis=1)))
        raise FormatError(path, "expected inf for moves out of the map, and from and to obstacles", line)
    weights = checked_weights(values.ravel(), (blocked & ~needed).ravel(), path, per_line=5).reshape(*free.shape, 5)
    return GuidanceGraph(weights[..., :4].transpose(2, 0, 1)[GGO_HEADINGS], np.where(free, weights[..., 4], 1))


def write(graph: GuidanceGraph, path: str | Path, grid: Grid) -> None:
    """Write a graph of the map `grid`."""
    columns = [*graph.move[GGO_HEADINGS], np.where(grid.free, graph.wait, np.float32(np.inf))]
    weights = np.stack(columns, axis=2).reshape(-1, 5)
    kinds, width = np.where(grid.free, ".", "@").ravel().tolist(), grid.shape[1]
    lines = [HEADER]
    for cell, (kind, row) in enumerate(zip(kinds, weights, strict=True)):
        values = ",".join("inf" if value == np.inf else repr(value) for value in as_numbers(row))
        lines.append(f"{cell},{kind},{cell // width},{cell % width},{values}")
    write_whole(Path(path), ("\n".join(lines) + "\n").encode())


def _parse(text: str, path: str | Path) -> tuple[Bools, Floats, Bools]:
    """Return the map (H, W), the weights (H * W, 5) float64, and which of them are `inf`."""
    lines = enumerate((line.rstrip("\r\n") for line in io.StringIO(text)), 1)
    header = next(lines, (1, ""))[1]
    if header != HEADER:
        raise FormatError(path, f"expected the header {HEADER}, got {shortened(header)}", 1)
    kinds, places, values = bytearray(), array("i"), array("d")
    for number, line in lines:
        match = _CELL.fullmatch(line)
        if match is None:
            raise FormatError(path, f"expected a cell: {HEADER}, got {shortened(line)}", number)
        cell, kind, row, col, *weights = match.groups()
        kinds += kind.encode()
        places.extend((int(cell), int(row), int(col)))
        values.extend(map(float, weights))
        if np.inf in values[-5:] and weights.count("inf") != values[-5:].count(np.inf):
            raise FormatError(path, "expected finite numbers or inf, got a number that is too large", number)
    if not kinds:
        raise FormatError(path, "expected a line for each cell, got none", 2)
    given = np.array(places).reshape(-1, 3)
    height, width = (given[-1, 1:] + 1).tolist()
    cells = np.arange(len(given))
    expected = np.stack([cells, cells // width, cells % width], axis=1)
    misplaced = (given != expected).any(axis=1)
    if misplaced.any() or height * width != len(given):
        worst = int(np.argmax(misplaced)) if misplaced.any() else len(given) - 1
        raise FormatError(path, f"expected all cells of {height} rows and {width} columns in reading order", 2 + worst)
    weights = np.array(values).reshape(-1, 5)
    free = np.isin(np.frombuffer(kinds, np.uint8), list(PASSABLE.encode())).reshape(height, width)
    return free, weights, np.isinf(weights)
