"""Who is near whom: what agents that share their observations go by."""

from __future__ import annotations

import numpy as np

from mapf_pz.arrays import Bools, Ints


def check_sharing(neighbors: int, radius: int) -> None:
    """Raise `ValueError` where one of the two is negative."""
    for name, value in (("neighbors", neighbors), ("radius", radius)):
        if value < 0:
            raise ValueError(f"{name}={value}: expected a whole number, 0 or more")


def nearest(positions: Ints, active: Bools, neighbors: int, radius: int) -> Ints:
    """Return the numbers (B, N, k) int64 of each agent's `k = neighbors` nearest others, nearest first; -1: none.

    Args:
        positions: (B, N, 2) int, [row, col].
        active: (B, N) bool: the agents on the map; the others have no neighbors and are none.
        neighbors: k, which may be more than there are.
        radius: how many rows, and how many columns, away another agent may be.

    The nearest is the one that the fewest steps up, down, left and right lead to; of two as near, the one of the lower
    number comes first.
    """
    apart = np.abs(positions[:, :, None] - positions[:, None])  # (B, N, N, 2)
    others = ~np.eye(active.shape[1], dtype=np.bool_)
    near = (apart.max(-1) <= radius) & active[:, :, None] & active[:, None] & others
    steps = np.where(near, apart.sum(-1), np.iinfo(np.int64).max)
    order = steps.argsort(-1, kind="stable")[..., :neighbors]
    found = np.full((*active.shape, neighbors), -1)
    found[..., : order.shape[-1]] = np.where(np.take_along_axis(near, order, -1), order, -1)
    return found
