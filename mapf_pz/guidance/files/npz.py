"""This package's format: a NumPy archive of the arrays `move`, `wait`, `map` (its name) and `digest`."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np

from mapf_pz._internal.arrays import Bools
from mapf_pz._internal.npz import read_npz, write_npz
from mapf_pz.errors import FormatError
from mapf_pz.guidance.files.weights import check_shape, checked_weights
from mapf_pz.guidance.graph import GuidanceGraph
from mapf_pz.instances.instance import Grid

MAX_BYTES = 2**27
"""Maximum size of the arrays of a file."""


def read(path: str | Path, grid: Grid | None) -> GuidanceGraph:
    """Read a guidance graph; raises as `load_guidance`."""
    arrays = read_npz(path, ("move", "wait", "map", "digest"), MAX_BYTES)
    move, wait = arrays["move"], arrays["wait"]
    if move.ndim != 3 or move.shape != (4, *wait.shape) or move.dtype.kind != "f" or wait.dtype.kind != "f":
        expected = "expected floating-point numbers 'move' (4, H, W) and 'wait' (H, W)"
        raise FormatError(path, f"{expected}, got {move.dtype} {move.shape} and {wait.dtype} {wait.shape}")
    if grid is not None:
        check_shape(wait.shape, grid, path)
        if str(arrays["digest"]) != map_digest(grid.free):
            name = str(arrays["map"])
            raise FormatError(path, f"expected weights of map {grid.name!r}, got those of another map, {name!r}")
    weights = checked_weights(move.ravel(), np.isposinf(move).ravel(), path).reshape(move.shape)
    waits = checked_weights(wait.ravel(), np.zeros(wait.size, np.bool_), path).reshape(wait.shape)
    return GuidanceGraph(weights, waits)


def write(graph: GuidanceGraph, path: str | Path, grid: Grid) -> None:
    """Write a graph of the map `grid`."""
    write_npz(path, {"move": graph.move, "wait": graph.wait, "map": grid.name, "digest": map_digest(grid.free)})


def map_digest(free: Bools) -> str:
    """Return the SHA-256 of a map (H, W): of H and W as little-endian 64-bit integers and one byte per cell."""
    return hashlib.sha256(np.array(free.shape, "<i8").tobytes() + free.astype(np.uint8).tobytes()).hexdigest()
