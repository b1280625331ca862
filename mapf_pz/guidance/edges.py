"""Arrays of edges, (4, H, W): for each heading and each cell, the move from the cell in that direction."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapf_pz._internal.arrays import Bools, Floats, Ints, Scalar
from mapf_pz.instances.heading import HEADING_STEPS, Heading


def open_edges(free: Bools) -> Bools:
    """Return which moves on the map `free` (H, W) lead from a free cell to a free cell: (4, H, W), by heading."""
    return of_target(free) & free


def opposite_edges(weights: Floats) -> Floats:
    """Return for each edge (4, H, W) the weight of the edge in the opposite direction; 0 outside the map."""
    values = np.zeros_like(weights)
    values[Heading.EAST, :, :-1] = weights[Heading.WEST, :, 1:]
    values[Heading.SOUTH, :-1] = weights[Heading.NORTH, 1:]
    values[Heading.WEST, :, 1:] = weights[Heading.EAST, :, :-1]
    values[Heading.NORTH, 1:] = weights[Heading.SOUTH, :-1]
    return values


def count_moves(positions: Ints, shape: tuple[int, int]) -> Ints:
    """Count the moves of agents: (4, H, W) int64, how often they left each cell to the east, south, west, north.

    Args:
        positions: (T + 1, N, 2), [row, col] of each agent after each step, such as `Plan.positions`.
        shape: (H, W).
    """
    counts = np.zeros((4, *shape), np.int64)
    before, steps = positions[:-1].reshape(-1, 2), np.diff(positions, axis=0).reshape(-1, 2)
    for heading, step in zip(Heading, HEADING_STEPS, strict=True):
        cells = before[(steps == step).all(axis=1)]
        np.add.at(counts[heading], (cells[:, 0], cells[:, 1]), 1)
    return counts


def of_target(values: NDArray[Scalar]) -> NDArray[Scalar]:
    """Return (4, H, W): the entry of `values` (H, W) at the cell that each move leads to; 0 off the map."""
    height, width = values.shape
    padded = np.zeros((height + 2, width + 2), values.dtype)
    padded[1:-1, 1:-1] = values
    return np.stack([padded[1 + r : 1 + r + height, 1 + c : 1 + c + width] for r, c in HEADING_STEPS.tolist()])
