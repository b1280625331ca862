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

BLOCK = 8
"""So many cells are copied at once, by one instruction."""
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
    num_blocks: int  # so many blocks of cells cover a row


class Stage(NamedTuple):
    """M maps of C cells, turned in R ways: S places each, rows one after the other, and then a block of nothing."""

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
        num_blocks=-(-width // BLOCK),
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
    size += BLOCK * sight.num_blocks
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
def cut(sight: Sight, stride: Array, windows: Windows, planes: Array, shown: Array, image: Array, drawn: Array) -> None:
    """Cut every agent's window out of the planes `shown` (W,) of the stage, into the planes `drawn` (W,) of the image.

    `planes` (R, P, S) are those of one environment, and `image` (N, K, V). Rows are copied in whole blocks, which write
    into the next row before that is copied; the last ones, where they would write past the plane, cell by cell. All of
    a block is read before any of it is written, or the compiler could not take it at once, and unsigned numbers spare
    it checks for negative ones.
    """
    height, width = np.uint64(sight.height), np.uint64(sight.width)
    in_blocks = np.uint64(0)  # so many rows
    while in_blocks < height and in_blocks * width + np.uint64(BLOCK * sight.num_blocks) <= np.uint64(image.shape[2]):
        in_blocks += np.uint64(1)
    for i in range(image.shape[0]):
        turn = windows.turn[i]
        step = np.uint64(stride[turn])
        for k in range(shown.size):
            source, target = planes[turn, shown[k]], image[i, drawn[k]]
            place, spot = np.uint64(windows.corner[i]), np.uint64(0)
            for _ in range(in_blocks):
                for block in range(sight.num_blocks):
                    p, q = place + np.uint64(BLOCK * block), spot + np.uint64(BLOCK * block)
                    cell_0 = source[p + np.uint64(0)]
                    cell_1 = source[p + np.uint64(1)]
                    cell_2 = source[p + np.uint64(2)]
                    cell_3 = source[p + np.uint64(3)]
                    cell_4 = source[p + np.uint64(4)]
                    cell_5 = source[p + np.uint64(5)]
                    cell_6 = source[p + np.uint64(6)]
                    cell_7 = source[p + np.uint64(7)]
                    target[q + np.uint64(0)] = cell_0
                    target[q + np.uint64(1)] = cell_1
                    target[q + np.uint64(2)] = cell_2
                    target[q + np.uint64(3)] = cell_3
                    target[q + np.uint64(4)] = cell_4
                    target[q + np.uint64(5)] = cell_5
                    target[q + np.uint64(6)] = cell_6
                    target[q + np.uint64(7)] = cell_7
                place += step
                spot += width
            for _ in range(in_blocks, height):
                for col in range(width):
                    target[spot + col] = source[place + col]
                place += step
                spot += width


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
