"""The scene: everything that can be observed, and what else than windows of the stage is noted to draw views."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapf_pz.core.jit import jit
from mapf_pz.core.stage import Sight, Span, Stage, Windows
from mapf_pz.core.state import Array, Distances, State, World


class Notes(NamedTuple):
    """What each of T threads notes about the views of the environment that it draws: scratch."""

    cells: Array  # (T, N, V) uint32: the map cell under each cell of the view; the number C outside the map
    seen: Array  # (T, N, V) bool: False where an obstacle hides the cell
    count: Array  # (T, N) int32: how many other agents are in view
    spots: Array  # (T, N, V) uint32: their places in the view, the first `count` of them
    others: Array  # (T, N, V) uint32: their indices


class Scene(NamedTuple):
    """Everything that can be observed."""

    sight: Sight
    rows: Span
    columns: Span
    stage: Stage
    windows: Windows
    notes: Notes
    world: World
    distances: Distances
    state: State
    cardinal: bool
    max_steps: int


def allocate_notes(num_threads: int, num_agents: int, num_cells: int) -> Notes:
    """Make room for views of V cells."""
    each, cells = (num_threads, num_agents), (num_threads, num_agents, num_cells)
    return Notes(
        cells=np.zeros(cells, np.uint32),
        seen=np.ones(cells, np.bool_),
        count=np.zeros(each, np.int32),
        spots=np.zeros(cells, np.uint32),
        others=np.zeros(cells, np.uint32),
    )


@jit
def note_cells(rows: Span, columns: Span, stage: Stage, windows: Windows, cells: Array) -> None:
    """Note the map cell under each cell of the views."""
    for i in range(cells.shape[0]):
        turn = windows.turn[i]
        here, noted = stage.cell[turn], cells[i]
        place, spot = np.uint64(windows.corner[i]), np.uint64(0)
        for _ in range(len(rows)):
            for col in range(len(columns)):
                noted[spot + np.uint64(col)] = here[place + np.uint64(col)]
            place += np.uint64(stage.stride[turn])
            spot += np.uint64(len(columns))


@jit
def note_seen(sight: Sight, obstacle: Array, cells: Array, seen: Array) -> None:
    """Note which cells are seen: those with no obstacle strictly between on the straight (Bresenham) line to them."""
    for i in range(cells.shape[0]):
        for j in range(cells.shape[1]):
            down, right = j // sight.width - sight.row, j % sight.width - sight.column
            length = max(abs(down), abs(right))
            seen[i, j] = True
            for k in range(1, length):
                r, c = sight.row + _between(down, k, length), sight.column + _between(right, k, length)
                if obstacle[cells[i, r * sight.width + c]] > 0:
                    seen[i, j] = False


@jit
def _between(offset: int, k: int, length: int) -> int:
    """Return step `k` of `length` towards `offset`, rounded to a whole cell, halves away from the observer."""
    return np.sign(offset) * ((2 * k * abs(offset) + length) // (2 * length))


@jit
def note_others(occupant: Array, cells: Array, seen: Array, count: Array, spots: Array, others: Array) -> None:
    """Note the other agents in each view."""
    for i in range(cells.shape[0]):
        found = 0
        for j in range(cells.shape[1]):
            other = occupant[cells[i, j]]
            if other >= 0 and other != i and seen[i, j]:
                spots[i, found], others[i, found] = j, other
                found += 1
        count[i] = found
