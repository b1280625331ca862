"""Generators of maps: the benchmark's families, from their parameters."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np

from mapf_pz.arrays import Bools
from mapf_pz.instance import Grid

Room = tuple[int, int]  # its row and column among rooms
Passage = tuple[Room, Room]

_DOORS = 0.6
"""Share of the walls of `room` that have a door though the rooms are joined without it; with it, about 80 % of all."""


def empty(height: int, width: int) -> Grid:
    """Make a map without obstacles: the benchmark's `empty-H-W`."""
    _check(height=height, width=width)
    return Grid(np.ones((height, width), np.bool_), f"empty-{height}-{width}")


def random(height: int, width: int, density: float, rng: np.random.Generator) -> Grid:
    """Make a map of independent obstacles: `density` of all cells, to the nearest number.

    Free cells may fall into several components.
    """
    _check(height=height, width=width)
    if not 0 <= density < 1:
        raise ValueError(f"density={density}: expected at least 0 and less than 1")
    free = np.ones(height * width, np.bool_)
    free[rng.choice(free.size, round(density * free.size), replace=False)] = False
    return Grid(free.reshape(height, width), f"random-{height}-{width}-{round(100 * density)}")


def maze(height: int, width: int, rng: np.random.Generator, corridor: int = 1) -> Grid:
    """Make a maze without cycles: corridors are `corridor` cells wide, walls one.

    As in the benchmark, walls run along the first row and column; the last ones are cut off where the size says.
    """
    _check(2, height=height, width=width)
    _check(corridor=corridor)
    free, rooms = _rooms(height, width, corridor + 1)
    for passage in _spanning_tree(rooms, rng):
        _wall(free, passage, corridor + 1)[:] = True
    return Grid(free, f"maze-{height}-{width}-{corridor}")


def room(height: int, width: int, rng: np.random.Generator, size: int) -> Grid:
    """Make rooms that are joined by doors of one cell.

    As in the benchmark, a room has `size` x `size` cells with its walls in the first row and column, about 80 % of the
    walls have a door, and the last rooms are cut off where the size says.
    """
    _check(2, height=height, width=width, size=size)
    free, rooms = _rooms(height, width, size)
    tree = set(_spanning_tree(rooms, rng))
    for passage in _neighbours(rooms):
        if passage in tree or rng.random() < _DOORS:
            wall = _wall(free, passage, size)
            wall[rng.integers(len(wall))] = True
    return Grid(free, f"room-{height}-{width}-{size}")


def warehouse(columns: int, rows: int, length: int, depth: int, aisle: int, margin: int | None = None) -> Grid:
    """Make a warehouse: the benchmark's `warehouse-COLUMNS-ROWS-LENGTH-DEPTH-AISLE`.

    Args:
        columns: Shelves beside each other.
        rows: Shelves below each other.
        length: Cells that a shelf takes from left to right.
        depth: Cells that a shelf takes from top to bottom.
        aisle: Free cells between shelves, and between them and the wall.
        margin: Free cells left and right of all shelves; by default as in the benchmark.
    """
    _check(columns=columns, rows=rows, length=length, depth=depth, aisle=aisle)
    # What the benchmark's three maps have in common: 25 cells for 10 shelves of 10 cells, 50 for 20 of 10.
    side = columns * length // 4 if margin is None else margin
    _check(0, margin=side)
    in_row = np.pad(_stripes(rows, depth, aisle), 1 + aisle)
    in_col = np.pad(_stripes(columns, length, aisle), 1 + side)
    free = ~np.logical_and.outer(in_row, in_col)
    free[[0, -1]] = free[:, [0, -1]] = False
    return Grid(free, f"warehouse-{columns}-{rows}-{length}-{depth}-{aisle}")


def on_canvas(grid: Grid, shape: tuple[int, int]) -> Grid:
    """Return the map in the upper left corner of a canvas of obstacles of `shape` (H, W), at least the map's own."""
    if grid.shape == shape:
        return grid
    free = np.zeros(shape, np.bool_)
    free[: grid.shape[0], : grid.shape[1]] = grid.free
    return Grid(free, grid.name)


def _check(least: int = 1, **sizes: int) -> None:
    for name, size in sizes.items():
        if size < least:
            raise ValueError(f"{name}={size}: expected a number of cells, {least} or more")


def _stripes(count: int, width: int, gap: int) -> Bools:
    """Return `count` times `width` cells True, with `gap` cells False between."""
    return (np.arange(count * (width + gap)) % (width + gap) < width)[:-gap]


def _rooms(height: int, width: int, pitch: int) -> tuple[Bools, list[Room]]:
    """Return a map (H, W) with a wall in every row and column that `pitch` divides, and its rooms."""
    free = np.logical_and.outer(np.arange(height) % pitch > 0, np.arange(width) % pitch > 0)
    rooms = product(range(-(-(height - 1) // pitch)), range(-(-(width - 1) // pitch)))
    return free, list(rooms)


def _neighbours(rooms: list[Room]) -> Iterator[Passage]:
    """Yield all pairs of rooms that share a wall, the upper or left one first."""
    known = set(rooms)
    for row, col in rooms:
        for other in ((row, col + 1), (row + 1, col)):
            if other in known:
                yield (row, col), other


def _wall(free: Bools, passage: Passage, pitch: int) -> Bools:
    """Return the wall between two neighbouring rooms, the upper or left one first, as a view of the map."""
    (row, _), (next_row, next_col) = passage
    top, left = next_row * pitch, next_col * pitch
    return free[top, left + 1 : left + pitch] if row < next_row else free[top + 1 : top + pitch, left]


def _spanning_tree(rooms: list[Room], rng: np.random.Generator) -> list[Passage]:
    """Join all rooms without cycles, by a depth-first walk into rooms not yet seen."""
    unseen = set(rooms)
    unseen.remove((0, 0))
    walk: list[Room] = [(0, 0)]
    tree: list[Passage] = []
    while walk:
        row, col = here = walk[-1]
        ahead = [to for to in ((row, col + 1), (row + 1, col), (row, col - 1), (row - 1, col)) if to in unseen]
        if ahead:
            to = ahead[rng.integers(len(ahead))]
            tree.append((min(here, to), max(here, to)))
            unseen.remove(to)
            walk.append(to)
        else:
            walk.pop()
    return tree
