"""Files of counted moves: a NumPy archive with the array `moves`."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mapf_pz._internal.arrays import Floats, Ints
from mapf_pz._internal.npz import read_npz, write_npz
from mapf_pz.errors import FormatError
from mapf_pz.guidance.files.npz import MAX_BYTES
from mapf_pz.instances.instance import Grid


def load_moves(path: str | Path, grid: Grid) -> Floats:
    """Read how often agents left each cell of the map `grid` to the east, south, west, north: (4, H, W) float64.

    Raises:
        FileNotFoundError: The file does not exist.
        FormatError: The file is malformed, is for a map of another size, or has a number that is negative or not
            finite.
    """
    moves = read_npz(path, ("moves",), MAX_BYTES)["moves"]
    if moves.shape != (4, *grid.shape) or moves.dtype.kind not in "iuf":
        expected = f"expected numbers 'moves' {(4, *grid.shape)} for map {grid.name!r}"
        raise FormatError(path, f"{expected}, got {moves.dtype} {moves.shape}")
    counts = moves.astype(np.float64)
    if not (np.isfinite(counts) & (counts >= 0)).all():
        raise FormatError(path, "expected finite numbers 0 or more in 'moves'")
    return counts


def save_moves(moves: Ints | Floats, path: str | Path) -> None:
    """Write how often agents left each cell, (4, H, W), such as `count_moves` returns, to an `.npz` file."""
    write_npz(path, {"moves": moves})
