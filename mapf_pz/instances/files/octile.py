"""Octile distances: the shortest path in eight directions that cuts no corners, as `.scen` files give it."""

from __future__ import annotations

import numpy as np

from mapf_pz._internal.arrays import Bools, Floats, Ints
from mapf_pz._internal.jit import Array, jit

_DIAGONAL = 1.414213562  # the root of 2 to as many digits as the benchmark took, so that its last columns come out


def octile_distances(free: Bools, starts: Ints, goals: Ints) -> Floats:
    """Return the distances (M,) float64 between free cells of the map `free` (H, W): `inf` where no path leads.

    `starts` and `goals` are (M, 2), [row, col]. A diagonal step needs both cells beside it free.
    """
    padded = np.pad(free, 1)
    width = padded.shape[1]
    cells = np.array([width, 1])
    distances = np.empty(len(starts))
    cost = np.empty(padded.size)
    steps, queues = np.empty((2, 2, padded.size), np.int32)
    _fill(padded.ravel(), width, (starts + 1) @ cells, (goals + 1) @ cells, cost, steps, queues, distances)
    return distances


@jit
def _fill(
    free: Array, width: int, starts: Array, goals: Array, cost: Array, steps: Array, queues: Array, out: Array
) -> None:
    """Fill `out` (M,) float64. `cost` (C,) float64, `steps` and `queues` (2, C) int32 are scratch."""
    for k in range(starts.size):
        out[k] = _distance(free, width, starts[k], goals[k], cost, steps, queues)


@jit
def _distance(free: Array, width: int, start: int, goal: int, cost: Array, steps: Array, queues: Array) -> float:
    """Search from `start`, with two queues as the priority queue: steps have two lengths, so each is sorted by itself.

    Costs are computed from the numbers of straight and diagonal `steps`, not added up: equal ones are then exactly
    equal, and a cell enters each queue at most once.
    """
    cost[:] = np.inf
    cost[start] = 0.0
    steps[:, start] = 0
    queues[0, 0] = start
    head, tail, diagonal_head, diagonal_tail = 0, 1, 0, 0
    while head < tail or diagonal_head < diagonal_tail:
        if head < tail and (diagonal_head == diagonal_tail or cost[queues[0, head]] <= cost[queues[1, diagonal_head]]):
            cell = queues[0, head]
            head += 1
        else:
            cell = queues[1, diagonal_head]
            diagonal_head += 1
        if cell == goal:
            return cost[cell]
        straights, diagonals = steps[0, cell], steps[1, cell]
        straight_cost = straights + 1 + diagonals * _DIAGONAL
        diagonal_cost = straights + (diagonals + 1) * _DIAGONAL
        for ahead, right in ((1, width), (width, -1), (-1, -width), (-width, 1)):
            to, corner = cell + ahead, cell + ahead + right
            if free[to] and straight_cost < cost[to]:
                cost[to] = straight_cost
                steps[0, to], steps[1, to] = straights + 1, diagonals
                queues[0, tail] = to
                tail += 1
            if free[to] and free[cell + right] and free[corner] and diagonal_cost < cost[corner]:
                cost[corner] = diagonal_cost
                steps[0, corner], steps[1, corner] = straights, diagonals + 1
                queues[1, diagonal_tail] = corner
                diagonal_tail += 1
    return np.inf
