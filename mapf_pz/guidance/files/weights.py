"""Checks of the weights in a file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from mapf_pz._internal.arrays import Bools, Floats
from mapf_pz.errors import FormatError
from mapf_pz.instances.instance import Grid

GGO_HEADINGS = [0, 3, 2, 1]
"""The headings in the order of GGO's files: right, up, left, down."""


def checked_weights(values: ArrayLike, blocked: ArrayLike, path: str | Path, per_line: int = 0) -> Floats:
    """Return `values` (M,) as float32, with `inf` where they are `blocked` (M,).

    Raises `FormatError` for the first other value that is not a finite float32 greater than 0. It names the line if the
    file has a header and then `per_line` values in each line.
    """
    given = np.asarray(values, np.float64)
    with np.errstate(over="ignore"):
        weights = np.where(blocked, np.inf, given).astype(np.float32)
    fits = np.asarray(blocked) | (np.isfinite(weights) & (weights > 0))
    if not fits.all():
        worst = int(np.argmin(fits))
        line = 2 + worst // per_line if per_line else 0
        place = "" if per_line else f" as weight {worst}"
        raise FormatError(path, f"expected a finite number greater than 0{place}, got {given[worst]:g}", line)
    return weights


def check_map(free: Bools, grid: Grid | None, path: str | Path) -> None:
    """Raise `FormatError` if there is a `grid` and the map of the file, `free`, is another one."""
    if grid is None:
        return
    check_shape(free.shape, grid, path)
    if not np.array_equal(free, grid.free):
        row, col = np.argwhere(free != grid.free)[0].tolist()
        message = f"expected weights of map {grid.name!r}, got those of a map that differs in [row {row}, col {col}]"
        raise FormatError(path, message)


def check_shape(shape: tuple[int, ...], grid: Grid, path: str | Path) -> None:
    """Raise `FormatError` if the map of the file has another `shape` (H, W) than `grid`."""
    if shape != grid.shape:
        expected = f"expected weights of map {grid.name!r} ({grid.shape[0]} x {grid.shape[1]})"
        raise FormatError(path, f"{expected}, got those of a map of {' x '.join(map(str, shape))} cells")


def as_numbers(weights: Floats) -> list[float]:
    """Return float32 weights as the numbers with the fewest digits that are read back as the same float32."""
    return weights.astype(np.str_).astype(np.float64).tolist()
