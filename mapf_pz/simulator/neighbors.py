"""Neighbors: each agent's nearest others, whose observations are appended to its own."""

from __future__ import annotations

import numpy as np
from numba import prange

from mapf_pz._internal.jit import Array, BatchKernel, jit

_FAR = np.iinfo(np.int32).max


@BatchKernel
def find_neighbors(width: int, radius: int, agents: Array, steps: Array, neighbors: Array) -> None:
    """Write the indices of each agent's nearest others to `neighbors` (B, N, K) int32, nearest first; -1: none.

    The others are at most `radius` rows and columns away. The nearest is the one that the fewest moves up, down, left
    and right lead to; of two as near, the one of the lower index comes first. Agents that have disappeared have no
    neighbors and are none. `steps` (B, N, K) int32 is scratch; the map is `width` cells wide.
    """
    for b in prange(agents.shape[0]):
        _find_neighbors_of(width, radius, agents[b], steps[b], neighbors[b])


@jit
def _find_neighbors_of(width: int, radius: int, agents: Array, steps: Array, neighbors: Array) -> None:
    for i in range(agents.size):
        steps[i, :] = _FAR
        neighbors[i, :] = -1
        if not agents[i].active:
            continue
        row, col = agents[i].cell // width, agents[i].cell % width
        for j in range(agents.size):
            rows, cols = abs(agents[j].cell // width - row), abs(agents[j].cell % width - col)
            if j != i and agents[j].active and max(rows, cols) <= radius:
                _insert(j, rows + cols, steps[i], neighbors[i])


@jit
def _insert(agent: int, distance: int, steps: Array, neighbors: Array) -> None:
    """Insert an agent into `neighbors` (K,) after those that are as near; the farthest one drops out."""
    k = neighbors.size
    while k > 0 and distance < steps[k - 1]:
        k -= 1
        if k + 1 < neighbors.size:
            steps[k + 1], neighbors[k + 1] = steps[k], neighbors[k]
    if k < neighbors.size:
        steps[k], neighbors[k] = distance, agent


@BatchKernel
def append_neighbors(neighbors: Array, own: Array, whole: Array) -> None:
    """Write each agent's `own` numbers (B, N, S), then those of its neighbors, to `whole` (B, N, 1 + K, S).

    `neighbors` (B, N, K) are indices of agents; for -1, zeros are written.
    """
    for b in prange(own.shape[0]):
        _append_neighbors_of(neighbors[b], own[b], whole[b])


@jit
def _append_neighbors_of(neighbors: Array, own: Array, whole: Array) -> None:
    for i in range(own.shape[0]):
        whole[i, 0, :] = own[i]
        for k in range(neighbors.shape[1]):
            if neighbors[i, k] >= 0:
                whole[i, k + 1, :] = own[neighbors[i, k]]
            else:
                whole[i, k + 1, :] = 0
