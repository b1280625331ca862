"""The inputs: everything that can be observed, and what else than origins of the layers is noted to draw views."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapf_pz.core.jit import jit
from mapf_pz.core.observation.layers import MapLayers, Span, ViewOrigins, ViewShape
from mapf_pz.core.state import Array, Distances, State, World


class ViewScratch(NamedTuple):
    """What each of T threads scratch about the views of the environment that it draws: scratch."""

    cells: Array  # (T, N, V) uint32: the map cell under each cell of the view; the number C outside the map
    seen: Array  # (T, N, V) bool: False where an obstacle hides the cell
    count: Array  # (T, N) int32: how many other agents are in view
    positions: Array  # (T, N, V) uint32: their places in the view, the first `count` of them
    others: Array  # (T, N, V) uint32: their indices


class ObservationInputs(NamedTuple):
    """Everything that can be observed."""

    view_shape: ViewShape
    rows: Span
    columns: Span
    layers: MapLayers
    origins: ViewOrigins
    scratch: ViewScratch
    world: World
    distances: Distances
    state: State
    cardinal: bool
    max_steps: int


def allocate_scratch(num_threads: int, num_agents: int, num_cells: int) -> ViewScratch:
    """Make room for views of V cells."""
    each, cells = (num_threads, num_agents), (num_threads, num_agents, num_cells)
    return ViewScratch(
        cells=np.zeros(cells, np.uint32),
        seen=np.ones(cells, np.bool_),
        count=np.zeros(each, np.int32),
        positions=np.zeros(cells, np.uint32),
        others=np.zeros(cells, np.uint32),
    )


@jit
def find_cells(rows: Span, columns: Span, layers: MapLayers, origins: ViewOrigins, cells: Array) -> None:
    """Note the map cell under each cell of the views."""
    for i in range(cells.shape[0]):
        turn = origins.turn[i]
        here, noted = layers.cell[turn], cells[i]
        at, target_at = np.uint64(origins.corner[i]), np.uint64(0)
        for _ in range(len(rows)):
            for col in range(len(columns)):
                noted[target_at + np.uint64(col)] = here[at + np.uint64(col)]
            at += np.uint64(layers.stride[turn])
            target_at += np.uint64(len(columns))


@jit
def find_visible(view_shape: ViewShape, obstacle: Array, cells: Array, seen: Array) -> None:
    """Note which cells are seen: those with no obstacle strictly between on the straight (Bresenham) line to them."""
    for i in range(cells.shape[0]):
        for j in range(cells.shape[1]):
            down, right = j // view_shape.width - view_shape.row, j % view_shape.width - view_shape.column
            length = max(abs(down), abs(right))
            seen[i, j] = True
            for k in range(1, length):
                r, c = view_shape.row + _between(down, k, length), view_shape.column + _between(right, k, length)
                if obstacle[cells[i, r * view_shape.width + c]] > 0:
                    seen[i, j] = False


@jit
def _between(offset: int, k: int, length: int) -> int:
    """Return step `k` of `length` towards `offset`, rounded to a whole cell, halves away from the observer."""
    return np.sign(offset) * ((2 * k * abs(offset) + length) // (2 * length))


@jit
def find_others(occupant: Array, cells: Array, seen: Array, count: Array, positions: Array, others: Array) -> None:
    """Note the other agents in each view."""
    for i in range(cells.shape[0]):
        found = 0
        for j in range(cells.shape[1]):
            other = occupant[cells[i, j]]
            if other >= 0 and other != i and seen[i, j]:
                positions[i, found], others[i, found] = j, other
                found += 1
        count[i] = found
