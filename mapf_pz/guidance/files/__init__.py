"""Files of guidance graphs; the extension determines the format."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from mapf_pz.guidance.files import ggo_csv, ggo_json, npz, wppl
from mapf_pz.guidance.files.moves import load_moves, save_moves
from mapf_pz.guidance.graph import GuidanceGraph
from mapf_pz.instances.instance import Grid

__all__ = ["FORMATS", "check_guidance_file", "load_guidance", "load_moves", "save_guidance", "save_moves"]


class Format(NamedTuple):
    """A file format."""

    read: Callable[[str | Path, Grid | None], GuidanceGraph]
    """Reads a file."""
    write: Callable[[GuidanceGraph, str | Path, Grid], None]
    """Writes a graph that has been restricted to the map."""


FORMATS = {
    ".json": Format(ggo_json.read, ggo_json.write),
    ".csv": Format(ggo_csv.read, ggo_csv.write),
    ".w": Format(wppl.read, wppl.write),
    ".npz": Format(npz.read, npz.write),
}
"""The file formats by extension."""


def load_guidance(path: str | Path, grid: Grid | None = None) -> GuidanceGraph:
    """Read a guidance graph: `.json` and `.csv` (GGO), `.w` (WPPL), or `.npz` (this package).

    Weights are rounded to float32. The result has `inf` for the moves that the map does not allow, and 1 for waiting on
    obstacles.

    Args:
        path: The file.
        grid: The map that the graph must be for. A `.w` file does not contain the map's size, so it needs one.

    Raises:
        FileNotFoundError: The file does not exist.
        FormatError: The file is malformed, or its weights are for another map than `grid`.
        ValueError: The extension is another one, or a `.w` file is read without `grid`.
    """
    return FORMATS[check_guidance_file(path)].read(path, grid)


def save_guidance(graph: GuidanceGraph, path: str | Path, grid: Grid) -> None:
    """Write a guidance graph for the map `grid` in the format of the extension; the file is replaced atomically.

    `load_guidance` returns the same weights, to the bit, except those that have no meaning on the map.

    Raises:
        ValueError: The extension is not one of `FORMATS`, the shapes of graph and map differ, or the format cannot hold
            a weight.
    """
    FORMATS[check_guidance_file(path)].write(graph.on_map(grid.free), path, grid)


def check_guidance_file(path: str | Path) -> str:
    """Return the extension of a guidance graph's file; raises `ValueError` if it is not one of `FORMATS`."""
    extension = Path(path).suffix
    if extension not in FORMATS:
        raise ValueError(f"guidance graph {str(path)!r}: expected a file name that ends in {', '.join(FORMATS)}")
    return extension
