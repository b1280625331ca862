"""The stage: the maps as they are looked at, so that a view is a window that is cut out row by row.

For egocentric views each map stands here four times, turned so that each heading is up in one of them; else once, north
up. Around it is a margin, as wide as views stick out. Planes that never change during an episode are drawn when a map
is laid out; agents enter the planes in which they are seen before an environment is observed, and leave them after it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapf_pz.core.jit import jit
from mapf_pz.core.state import Array
from mapf_pz.types import HEADING_STEPS, Heading

CROWD, FACING, EDGES = 0, 1, (2, 3, 4, 5)
"""Planes of the stage: 1 on obstacles and 0.5 on agents; `(1 + k) / 4` on agents of heading `k`; weights of edges."""


class Sight(NamedTuple):
    """The geometry of a view of `V = h * w` cells."""

    height: int
    width: int
    row: int  # the observer's own row in the view
    column: int
    see_through_walls: bool
    num_turns: int  # R: 4, each heading is up in one of the turned maps; or 1, north is up


Span = tuple[int, ...]
"""The rows or the columns of a view. The length of a tuple, unlike a number, is known when a kernel is compiled."""


class Stage(NamedTuple):
    """M maps of C cells, turned in R ways: S places each, rows one after the other."""

    num_threads: int  # T
    stride: Array  # (R,) int32: the length of a row
    own: Array  # (R,) int32: the observer's place less that of its view's first cell
    corner: Array  # (C, R) int32: the place of the first cell of a view from each map cell
    cell: Array  # (R, S) uint32: the map cell at each place; the number C in the margin
    planes: Array  # (X, R, P, S) float32: P = 6, or 2 without weights of edges
    shared: bool  # X is T and not M, as there is one map: agents enter the planes, so that each thread needs its own


def make_sight(view_size: tuple[int, int], row: int, egocentric: bool, see_through_walls: bool) -> Sight:
    """Return the geometry of a view of (h, w) cells, with the observer in the middle of `row`."""
    height, width = view_size
    return Sight(
        height=height,
        width=width,
        row=row,
        column=width // 2,
        see_through_walls=see_through_walls,
        num_turns=len(Heading) if egocentric else 1,
    )


def allocate_stage(sight: Sight, shape: tuple[int, int], num_maps: int, num_threads: int, with_edges: bool) -> Stage:
    """Make room for maps of `shape` (H, W), and number their places."""
    map_rows, map_cols = np.indices(shape).reshape(2, -1)
    turned = []
    for up in Heading if sight.num_turns > 1 else (Heading.NORTH,):
        (down, right), (turned_down, turned_right) = HEADING_STEPS[up], HEADING_STEPS[(up + 1) % 4]
        rows, cols = -(map_rows * down + map_cols * right), map_rows * turned_down + map_cols * turned_right
        turned.append((rows - rows.min(), cols - cols.min()))
    stride = np.array([cols.max() + sight.width for _, cols in turned], np.int32)
    size = max((rows.max() + sight.height) * length for (rows, _), length in zip(turned, stride, strict=True))
    num_stages = num_threads if num_maps == 1 else num_maps
    num_planes = EDGES[-1] + 1 if with_edges else EDGES[0]
    corners = [rows * length + cols for (rows, cols), length in zip(turned, stride, strict=True)]
    stage = Stage(
        num_threads=num_threads,
        stride=stride,
        own=sight.row * stride + np.int32(sight.column),
        corner=np.stack(corners, axis=1).astype(np.int32),
        cell=np.full((len(turned), size), map_rows.size, np.uint32),
        planes=np.zeros((num_stages, len(turned), num_planes, size), np.float32),
        shared=num_maps == 1,
    )
    for turn, own in enumerate(stage.own):
        stage.cell[turn, stage.corner[:, turn] + own] = np.arange(map_rows.size)
    stage.planes[:, :, CROWD] = 1
    return stage


@jit
def lay_out(planes: Array, stage: Stage, weight: Array, obstacle: Array) -> None:
    """Draw a map's planes (R, P, S): obstacles, and weights over the largest finite one; -1: the edge is blocked."""
    largest = _largest(weight)
    for turn in range(planes.shape[0]):
        for cell in range(stage.corner.shape[0]):
            place = stage.corner[cell, turn] + stage.own[turn]
            planes[turn, CROWD, place] = obstacle[cell]
            for k in range(planes.shape[1] - EDGES[0]):
                price = weight[(turn + k) % 4, cell]  # the first direction is that of the turn, or east
                planes[turn, EDGES[0] + k, place] = price / largest if price < np.inf else -1.0


@jit
def _largest(weight: Array) -> float:
    """Return the largest finite weight of a move; 0 where there is none."""
    largest = 0.0
    for towards in range(4):
        for price in weight[towards]:
            if largest < price < np.inf:
                largest = price
    return largest


class Windows(NamedTuple):
    """Where the views are cut out: of B x N agents, or of the N of one environment."""

    turn: Array  # (B, N) uint32: from which of the turned maps
    corner: Array  # (B, N) uint32: the place of the first cell there


def allocate_windows(num_envs: int, num_agents: int) -> Windows:
    """Make room for B x N agents."""
    each = (num_envs, num_agents)
    return Windows(np.zeros(each, np.uint32), np.zeros(each, np.uint32))


@jit
def enter(sight: Sight, stage: Stage, windows: Windows, crew: Array, planes: Array) -> None:
    """Set where each agent's view is, and let active agents appear in the planes (R, P, S)."""
    num_turns = sight.num_turns
    for i in range(crew.size):
        agent = crew[i]
        cell, heading = np.uint32(agent.cell), int(agent.heading)
        windows.turn[i] = heading if num_turns > 1 else 0
        windows.corner[i] = stage.corner[cell, windows.turn[i]]
        if agent.active:
            for turn in range(num_turns):
                place = np.uint32(stage.corner[cell, turn] + stage.own[turn])
                planes[turn, CROWD, place] = 0.5
                planes[turn, FACING, place] = facing(turn, heading)


@jit
def facing(turn: int, heading: int) -> np.float32:
    """Return how a heading is shown where `turn` is up: `(1 + k) / 4`."""
    return np.float32(1 + ((heading - turn) & 3)) * np.float32(0.25)


@jit
def leave(sight: Sight, stage: Stage, crew: Array, planes: Array) -> None:
    """Let them disappear again."""
    for i in range(crew.size):
        cell = np.uint32(crew[i].cell)
        if crew[i].active:
            for turn in range(sight.num_turns):
                place = np.uint32(stage.corner[cell, turn] + stage.own[turn])
                planes[turn, CROWD, place] = 0.0
                planes[turn, FACING, place] = 0.0


@jit
def cut(
    rows: Span, columns: Span, stride: Array, windows: Windows, planes: Array, shown: Array, image: Array, drawn: Array
) -> None:
    """Cut every agent's window out of the planes `shown` (W,) of the stage, into the planes `drawn` (W,) of the image.

    `planes` (R, P, S) are those of one environment, and `image` (N, K, V).
    """
    # One-dimensional arrays and unsigned numbers spare much reckoning.
    source, target = planes.reshape(-1), image.reshape(-1)
    num_planes, size = np.uint64(planes.shape[1]), np.uint64(planes.shape[2])
    num_drawn, num_cells = np.uint64(image.shape[1]), np.uint64(len(rows) * len(columns))
    for i in range(image.shape[0]):
        turn, corner = np.uint64(windows.turn[i]), np.uint64(windows.corner[i])
        step = np.uint64(stride[turn])
        for k in range(shown.size):
            place = (turn * num_planes + np.uint64(shown[k])) * size + corner
            spot = (np.uint64(i) * num_drawn + np.uint64(drawn[k])) * num_cells
            for _ in range(len(rows)):
                _copy_row(columns, source, place, target, spot)
                place += step
                spot += np.uint64(len(columns))


@jit
def _copy_row(columns: Span, source: Array, place: int, target: Array, spot: int) -> None:
    """Copy as many cells as there are columns: eight at once, then four, of which some may be copied twice."""
    width = len(columns)
    for col in range(0, width - 7, 8):
        _copy_eight(source, place + np.uint64(col), target, spot + np.uint64(col))
    if width % 8 >= 4:
        _copy_four(source, place + np.uint64(width // 8 * 8), target, spot + np.uint64(width // 8 * 8))
    if width > 4 and width % 4:
        _copy_four(source, place + np.uint64(width - 4), target, spot + np.uint64(width - 4))
    for col in range(width if width < 4 else 0):
        target[spot + np.uint64(col)] = source[place + np.uint64(col)]


@jit
def _copy_four(source: Array, place: int, target: Array, spot: int) -> None:
    """Copy four cells: all are read before any is written, or the compiler could not take them at once."""
    cell_0, cell_1 = source[place], source[place + np.uint64(1)]
    cell_2, cell_3 = source[place + np.uint64(2)], source[place + np.uint64(3)]
    target[spot], target[spot + np.uint64(1)] = cell_0, cell_1
    target[spot + np.uint64(2)], target[spot + np.uint64(3)] = cell_2, cell_3


@jit
def _copy_eight(source: Array, place: int, target: Array, spot: int) -> None:
    """Copy eight cells in the same way."""
    cell_0, cell_1 = source[place], source[place + np.uint64(1)]
    cell_2, cell_3 = source[place + np.uint64(2)], source[place + np.uint64(3)]
    cell_4, cell_5 = source[place + np.uint64(4)], source[place + np.uint64(5)]
    cell_6, cell_7 = source[place + np.uint64(6)], source[place + np.uint64(7)]
    target[spot], target[spot + np.uint64(1)] = cell_0, cell_1
    target[spot + np.uint64(2)], target[spot + np.uint64(3)] = cell_2, cell_3
    target[spot + np.uint64(4)], target[spot + np.uint64(5)] = cell_4, cell_5
    target[spot + np.uint64(6)], target[spot + np.uint64(7)] = cell_6, cell_7


@jit
def clear(image: Array, i: int, plane: int) -> None:
    """Set a plane of agent `i` to 0."""
    for j in range(image.shape[2]):
        image[i, plane, j] = 0.0


@jit
def mark(sight: Sight, stage: Stage, windows: Windows, cell: int, image: Array, i: int, plane: int) -> None:
    """Set 1 where in agent `i`'s view a map cell is, if it is there."""
    turn = windows.turn[i]
    ahead = stage.corner[cell, turn] + stage.own[turn] - np.int64(windows.corner[i])
    if ahead >= 0:
        # Both numbers are below 2^32, for which a processor divides faster.
        row = np.int64(np.uint32(ahead) // np.uint32(stage.stride[turn]))
        col = ahead - row * stage.stride[turn]
        if row < sight.height and col < sight.width:
            image[i, plane, row * sight.width + col] = 1.0
