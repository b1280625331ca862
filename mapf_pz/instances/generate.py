"""Map generators for the families of the benchmark."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np

from mapf_pz._internal.arrays import Bools
from mapf_pz.instances.instance import Grid

Room = tuple[int, int]  # row and column in the grid of rooms
Passage = tuple[Room, Room]

MAX_SIZE = 2**30
"""Maximum of every number of cells."""
_TURNS = 0.2
"""Probability of a turn of a wall of `walls` at each post."""
_DOORS = 0.6
"""Probability of a door in a wall of `room` that connectivity does not need; about 80 % of all walls then have one."""


def empty(height: int, width: int) -> Grid:
    """Generate a map without obstacles: the benchmark's `empty-H-W`."""
    _check(height=height, width=width)
    return Grid(np.ones((height, width), np.bool_), f"empty-{height}-{width}")


def random(height: int, width: int, density: float, rng: np.random.Generator) -> Grid:
    """Generate a map of random obstacles: a fraction `density` of all cells, rounded to the nearest number of cells.

    The free cells may not be connected.
    """
    _check(height=height, width=width)
    _check_density(density)
    free = np.ones(height * width, np.bool_)
    free[rng.choice(free.size, round(density * free.size), replace=False)] = False
    return Grid(free.reshape(height, width), f"random-{height}-{width}-{round(100 * density)}")


def maze(height: int, width: int, rng: np.random.Generator, corridor: int = 1, loops: float = 0.0) -> Grid:
    """Generate a maze, with corridors of `corridor` cells and walls of one cell.

    As in the benchmark, the first row and column are walls, and the maze is cropped to the size of the map. `loops` is
    the fraction of the other walls that are open; with 0, as in the benchmark, there is one path between two cells.
    """
    _check(2, height=height, width=width)
    _check(corridor=corridor)
    free, rooms = _rooms(height, width, corridor + 1)
    tree = set(_spanning_tree(rooms, rng))
    for passage in _neighbors(rooms):
        if passage in tree or (loops > 0 and rng.random() < loops):
            _wall(free, passage, corridor + 1)[:] = True
    return Grid(free, f"maze-{height}-{width}-{corridor}")


def walls(height: int, width: int, rng: np.random.Generator, density: float) -> Grid:
    """Generate a map with free-standing walls of one cell, which branch and turn; all free cells are connected.

    Walls grow from posts in odd rows and columns until a fraction `density` of the cells are obstacles, or until there
    is no more space. A wall ends before it would meet another one or the edge of the map.
    """
    _check(height=height, width=width)
    _check_density(density)
    free = np.ones((height, width), np.bool_)
    posts = list(product(range(1, height - 1, 2), range(1, width - 1, 2)))
    missing = round(density * free.size)
    for k in rng.integers(len(posts), size=4 * len(posts)) if posts else ():
        if missing <= 0:
            break
        missing -= _grow_wall(free, posts[k], rng, min(missing, int(rng.integers(3, 20))))
    return Grid(free, f"walls-{height}-{width}-{round(100 * density)}")


def _grow_wall(free: Bools, post: Room, rng: np.random.Generator, length: int) -> int:
    """Grow a wall of at most `length` cells from a post, which may be part of a wall; return the number of cells."""
    (row, col), way = post, int(rng.integers(4))
    grown = int(free[post])  # counting the free cells of the map takes as long as many walls
    free[post] = False
    for _ in range(length // 2):
        if rng.random() < _TURNS:
            way = (way + (1, 3)[rng.integers(2)]) % 4
        down, right = ((0, 1), (1, 0), (0, -1), (-1, 0))[way]
        end = row + 2 * down, col + 2 * right
        if not (0 < end[0] < free.shape[0] - 1 and 0 < end[1] < free.shape[1] - 1 and free[end]):
            break
        grown += int(free[row + down, col + right]) + 1
        free[row + down, col + right] = free[end] = False
        row, col = end
    return grown


def primal2(
    height: int, width: int, rng: np.random.Generator, density: float, components: int = 6, straight: float = 0.8
) -> Grid:
    """Generate a maze as those of PRIMAL2 and of POGEMA's benchmark; the free cells may not be connected.

    Posts are in every second row and column, on the edge around the map, too. Walls of one cell grow from
    `density * (height + 2) * (width + 2) // components` random posts, in at most `components` steps from one post to
    the next one. A step goes straight on with the weight `straight`, and in each other way with `1 - straight`; none
    is taken to a post that has a wall. With an even size, the last row or column is cropped.

    Sources: G. Sartoretti et al., PRIMAL, RA-L 2019; M. Damani et al., PRIMAL2, RA-L 2021; the parameters' ranges in
    POGEMA's benchmark are 0 to 1, 4 to 8, and 0.75 to 0.85.
    """
    _check(height=height, width=width, components=components)
    if not 0 <= density <= 1:
        raise ValueError(f"density={density}: expected a number from 0 to 1")
    if not 0 <= straight < 1:
        raise ValueError(f"straight={straight}: expected at least 0 and less than 1")
    free = np.ones((height // 2 * 2 + 3, width // 2 * 2 + 3), np.bool_)
    free[[0, -1]] = free[:, [0, -1]] = False
    for _ in range(int(density * free.size / components)):
        post = 2 * int(rng.integers(free.shape[0] // 2)), 2 * int(rng.integers(free.shape[1] // 2))
        _grow_through_posts(free, post, rng, components, straight)
    return Grid(free[1 : height + 1, 1 : width + 1], f"primal2-{height}-{width}-{round(100 * density)}")


def _grow_through_posts(free: Bools, post: Room, rng: np.random.Generator, steps: int, straight: float) -> None:
    """Grow a wall from a post to others that have no wall: see `primal2`."""
    (row, col), way = post, (0, 0)
    free[post] = False
    for _ in range(steps):
        ways = [
            (down, right)
            for down, right in ((0, -2), (0, 2), (-2, 0), (2, 0))
            if 0 <= row + down < free.shape[0] and 0 <= col + right < free.shape[1]
        ]
        ends = np.cumsum([straight if each == way else 1 - straight for each in ways])
        way = ways[int(np.searchsorted(ends, rng.random() * ends[-1], side="right"))]
        to = row + way[0], col + way[1]
        if free[to]:
            free[to] = free[row + way[0] // 2, col + way[1] // 2] = False
            row, col = to


def room(height: int, width: int, rng: np.random.Generator, size: int) -> Grid:
    """Generate a map of rooms that are connected by doors of one cell.

    As in the benchmark, a room has `size` x `size` cells including the walls in its first row and column, about 80 % of
    the walls have a door, and the last rooms are cropped to the size of the map.
    """
    _check(2, height=height, width=width, size=size)
    free, rooms = _rooms(height, width, size)
    tree = set(_spanning_tree(rooms, rng))
    for passage in _neighbors(rooms):
        if passage in tree or rng.random() < _DOORS:
            wall = _wall(free, passage, size)
            wall[rng.integers(len(wall))] = True
    return Grid(free, f"room-{height}-{width}-{size}")


def warehouse(columns: int, rows: int, length: int, depth: int, aisle: int, margin: int | None = None) -> Grid:
    """Generate a warehouse: the benchmark's `warehouse-COLUMNS-ROWS-LENGTH-DEPTH-AISLE`.

    Args:
        columns: Number of columns of shelves.
        rows: Number of rows of shelves.
        length: Width of a shelf in cells.
        depth: Height of a shelf in cells.
        aisle: Number of free cells between shelves, and above and below them.
        margin: Number of free cells to the left and right of all shelves; by default as in the benchmark.
    """
    _check(columns=columns, rows=rows, length=length, depth=depth, aisle=aisle)
    # Fits all three maps of the benchmark: 25 cells for 10 shelves of 10 cells, 50 for 20 shelves of 10.
    side = columns * length // 4 if margin is None else margin
    _check(0, margin=side)
    in_row = np.pad(_stripes(rows, depth, aisle), 1 + aisle)
    in_col = np.pad(_stripes(columns, length, aisle), 1 + side)
    free = ~np.logical_and.outer(in_row, in_col)
    free[[0, -1]] = free[:, [0, -1]] = False
    return Grid(free, f"warehouse-{columns}-{rows}-{length}-{depth}-{aisle}")


def on_canvas(grid: Grid, shape: tuple[int, int]) -> Grid:
    """Return the map in the upper left corner of a map of obstacles of `shape` (H, W), which must not be smaller."""
    if grid.shape == shape:
        return grid
    free = np.zeros(shape, np.bool_)
    free[: grid.shape[0], : grid.shape[1]] = grid.free
    return Grid(free, grid.name)


def _check_density(density: float) -> None:
    if not 0 <= density < 1:
        raise ValueError(f"density={density}: expected at least 0 and less than 1")


def _check(least: int = 1, **sizes: int) -> None:
    for name, size in sizes.items():
        if size < least:
            raise ValueError(f"{name}={size}: expected a number of cells, {least} or more")
        if size > MAX_SIZE:
            raise ValueError(f"{name}={size}: expected a number of cells, at most {MAX_SIZE}")


def _stripes(count: int, width: int, gap: int) -> Bools:
    """Return `count` stripes of `width` True cells, separated by `gap` False cells."""
    return (np.arange(count * (width + gap)) % (width + gap) < width)[:-gap]


def _rooms(height: int, width: int, pitch: int) -> tuple[Bools, list[Room]]:
    """Return a map (H, W) with walls in every `pitch`-th row and column, and the list of its rooms."""
    free = np.logical_and.outer(np.arange(height) % pitch > 0, np.arange(width) % pitch > 0)
    rooms = product(range(-(-(height - 1) // pitch)), range(-(-(width - 1) // pitch)))
    return free, list(rooms)


def _neighbors(rooms: list[Room]) -> Iterator[Passage]:
    """Yield all pairs of rooms that share a wall, the upper or left room first."""
    known = set(rooms)
    for row, col in rooms:
        for other in ((row, col + 1), (row + 1, col)):
            if other in known:
                yield (row, col), other


def _wall(free: Bools, passage: Passage, pitch: int) -> Bools:
    """Return the wall between two adjacent rooms, the upper or left room first, as a view of the map."""
    (row, _), (next_row, next_col) = passage
    top, left = next_row * pitch, next_col * pitch
    return free[top, left + 1 : left + pitch] if row < next_row else free[top + 1 : top + pitch, left]


def _spanning_tree(rooms: list[Room], rng: np.random.Generator) -> list[Passage]:
    """Return a spanning tree of the rooms from a randomized depth-first search."""
    unvisited = set(rooms)
    unvisited.remove((0, 0))
    stack: list[Room] = [(0, 0)]
    tree: list[Passage] = []
    while stack:
        row, col = here = stack[-1]
        ahead = [to for to in ((row, col + 1), (row + 1, col), (row, col - 1), (row - 1, col)) if to in unvisited]
        if ahead:
            to = ahead[rng.integers(len(ahead))]
            tree.append((min(here, to), max(here, to)))
            unvisited.remove(to)
            stack.append(to)
        else:
            stack.pop()
    return tree
