"""The layers of a map: planes from which each agent's view is copied, row by row.

For egocentric views each map is stored four times, rotated so that each heading is up in one of them; otherwise once,
with north up. A margin around it is as wide as views extend beyond the map. What never changes during an episode is
drawn when the map is set; agents are drawn before an environment is observed, and erased afterwards.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapf_pz.actions import HEADING_STEPS, Heading
from mapf_pz.core.jit import jit
from mapf_pz.core.state import Array

OCCUPANCY, HEADING, EDGES = 0, 1, (2, 3, 4, 5)
"""The planes: 1 on obstacles and 0.5 on agents; `(1 + k) / 4` on agents of heading `k`; weights of edges."""
GOAL = -1
"""Not a plane: each agent's own goal, which is drawn into its view."""


class ViewShape(NamedTuple):
    """The geometry of a view of `V = h * w` cells."""

    height: int
    width: int
    row: int  # the observer's own row in the view
    column: int
    see_through_walls: bool
    num_turns: int  # R: 4, each heading is up in one of the rotated maps; or 1, north is up


Span = tuple[int, ...]
"""The rows or the columns of a view. The length of a tuple, unlike a number, is known when a kernel is compiled."""


class MapLayers(NamedTuple):
    """M maps of C cells in R rotations: S entries each, row by row, with a margin."""

    num_threads: int  # T
    stride: Array  # (R,) int32: the length of a row
    own: Array  # (R,) int32: index of the observer minus that of its view's first cell
    corner: Array  # (C, R) int32: index of the first cell of the view from each map cell
    cell: Array  # (R, S) uint32: the map cell at each entry; the number C in the margin
    planes: Array  # (X, R, P, S) float32: P = 6, or 2 without weights of edges
    shared: bool  # one map for all environments: X is T, a copy for each thread to draw agents on; otherwise X is M


def make_view_shape(view_size: tuple[int, int], row: int, egocentric: bool, see_through_walls: bool) -> ViewShape:
    """Return the geometry of a view of (h, w) cells, with the observer in the middle of `row`."""
    height, width = view_size
    return ViewShape(
        height=height,
        width=width,
        row=row,
        column=width // 2,
        see_through_walls=see_through_walls,
        num_turns=len(Heading) if egocentric else 1,
    )


def allocate_layers(
    view_shape: ViewShape, shape: tuple[int, int], num_maps: int, num_threads: int, with_edges: bool
) -> MapLayers:
    """Make room for maps of `shape` (H, W), and number their places."""
    map_rows, map_cols = np.indices(shape).reshape(2, -1)
    turned = []
    for up in Heading if view_shape.num_turns > 1 else (Heading.NORTH,):
        (down, right), (turned_down, turned_right) = HEADING_STEPS[up], HEADING_STEPS[(up + 1) % 4]
        rows, cols = -(map_rows * down + map_cols * right), map_rows * turned_down + map_cols * turned_right
        turned.append((rows - rows.min(), cols - cols.min()))
    stride = np.array([cols.max() + view_shape.width for _, cols in turned], np.int32)
    size = max((rows.max() + view_shape.height) * length for (rows, _), length in zip(turned, stride, strict=True))
    num_stages = num_threads if num_maps == 1 else num_maps
    num_planes = EDGES[-1] + 1 if with_edges else EDGES[0]
    corners = [rows * length + cols for (rows, cols), length in zip(turned, stride, strict=True)]
    layers = MapLayers(
        num_threads=num_threads,
        stride=stride,
        own=view_shape.row * stride + np.int32(view_shape.column),
        corner=np.stack(corners, axis=1).astype(np.int32),
        cell=np.full((len(turned), size), map_rows.size, np.uint32),
        planes=np.zeros((num_stages, len(turned), num_planes, size), np.float32),
        shared=num_maps == 1,
    )
    for turn, own in enumerate(layers.own):
        layers.cell[turn, layers.corner[:, turn] + own] = np.arange(map_rows.size)
    layers.planes[:, :, OCCUPANCY] = 1
    return layers


@jit
def draw_map(planes: Array, layers: MapLayers, weight: Array, obstacle: Array) -> None:
    """Draw a map's planes (R, P, S): obstacles, and weights over the largest finite one; -1: the edge is blocked."""
    largest = _largest(weight)
    for turn in range(planes.shape[0]):
        for cell in range(layers.corner.shape[0]):
            at = layers.corner[cell, turn] + layers.own[turn]
            planes[turn, OCCUPANCY, at] = obstacle[cell]
            for k in range(planes.shape[1] - EDGES[0]):
                cost = weight[(turn + k) % 4, cell]  # the first direction is that of the turn, or east
                planes[turn, EDGES[0] + k, at] = cost / largest if cost < np.inf else -1.0


@jit
def _largest(weight: Array) -> float:
    """Return the largest finite weight of a move; 0 where there is none."""
    largest = 0.0
    for towards in range(4):
        for cost in weight[towards]:
            if largest < cost < np.inf:
                largest = cost
    return largest


class ViewOrigins(NamedTuple):
    """Where views are copied from: of B x N agents, or of the N agents of one environment."""

    turn: Array  # (B, N) uint32: from which of the rotated maps
    corner: Array  # (B, N) uint32: index of the first cell in it


def allocate_origins(num_envs: int, num_agents: int) -> ViewOrigins:
    """Make room for B x N agents."""
    each = (num_envs, num_agents)
    return ViewOrigins(np.zeros(each, np.uint32), np.zeros(each, np.uint32))


@jit
def draw_agents(view_shape: ViewShape, layers: MapLayers, origins: ViewOrigins, agents: Array, planes: Array) -> None:
    """Set where each agent's view is copied from, and draw active agents on the planes (R, P, S)."""
    num_turns = view_shape.num_turns
    for i in range(agents.size):
        agent = agents[i]
        cell, heading = np.uint32(agent.cell), int(agent.heading)
        origins.turn[i] = heading if num_turns > 1 else 0
        origins.corner[i] = layers.corner[cell, origins.turn[i]]
        if agent.active:
            for turn in range(num_turns):
                at = np.uint32(layers.corner[cell, turn] + layers.own[turn])
                planes[turn, OCCUPANCY, at] = 0.5
                planes[turn, HEADING, at] = heading_value(turn, heading)


@jit
def heading_value(turn: int, heading: int) -> np.float32:
    """Return how a heading is shown where `turn` is up: `(1 + k) / 4`."""
    return np.float32(1 + ((heading - turn) & 3)) * np.float32(0.25)


@jit
def erase_agents(view_shape: ViewShape, layers: MapLayers, agents: Array, planes: Array) -> None:
    """Erase the agents that `draw_agents` drew."""
    for i in range(agents.size):
        cell = np.uint32(agents[i].cell)
        if agents[i].active:
            for turn in range(view_shape.num_turns):
                at = np.uint32(layers.corner[cell, turn] + layers.own[turn])
                planes[turn, OCCUPANCY, at] = 0.0
                planes[turn, HEADING, at] = 0.0


@jit
def copy_windows(
    rows: Span,
    columns: Span,
    stride: Array,
    origins: ViewOrigins,
    planes: Array,
    shown: Array,
    image: Array,
    drawn: Array,
) -> None:
    """Copy each agent's view from the planes `shown` (W,) of the layers to the planes `drawn` (W,) of the image.

    `planes` (R, P, S) are those of one environment, and `image` (N, K, V).
    """
    # Indexing one-dimensional arrays with unsigned numbers takes fewer instructions.
    source, target = planes.reshape(-1), image.reshape(-1)
    num_planes, size = np.uint64(planes.shape[1]), np.uint64(planes.shape[2])
    num_drawn, num_cells = np.uint64(image.shape[1]), np.uint64(len(rows) * len(columns))
    for i in range(image.shape[0]):
        turn, corner = np.uint64(origins.turn[i]), np.uint64(origins.corner[i])
        step = np.uint64(stride[turn])
        for k in range(shown.size):
            at = (turn * num_planes + np.uint64(shown[k])) * size + corner
            target_at = (np.uint64(i) * num_drawn + np.uint64(drawn[k])) * num_cells
            for _ in range(len(rows)):
                _copy_row(columns, source, at, target, target_at)
                at += step
                target_at += np.uint64(len(columns))


@jit
def _copy_row(columns: Span, source: Array, at: int, target: Array, target_at: int) -> None:
    """Copy as many cells as there are columns: eight at once, then four, of which some may be copied twice."""
    width = len(columns)
    for col in range(0, width - 7, 8):
        _copy_eight(source, at + np.uint64(col), target, target_at + np.uint64(col))
    if width % 8 >= 4:
        _copy_four(source, at + np.uint64(width // 8 * 8), target, target_at + np.uint64(width // 8 * 8))
    if width > 4 and width % 4:
        _copy_four(source, at + np.uint64(width - 4), target, target_at + np.uint64(width - 4))
    for col in range(width if width < 4 else 0):
        target[target_at + np.uint64(col)] = source[at + np.uint64(col)]


@jit
def _copy_four(source: Array, at: int, target: Array, target_at: int) -> None:
    """Copy four cells: all are read before any is written, or the compiler could not take them at once."""
    cell_0, cell_1 = source[at], source[at + np.uint64(1)]
    cell_2, cell_3 = source[at + np.uint64(2)], source[at + np.uint64(3)]
    target[target_at], target[target_at + np.uint64(1)] = cell_0, cell_1
    target[target_at + np.uint64(2)], target[target_at + np.uint64(3)] = cell_2, cell_3


@jit
def _copy_eight(source: Array, at: int, target: Array, target_at: int) -> None:
    """Copy eight cells in the same way."""
    cell_0, cell_1 = source[at], source[at + np.uint64(1)]
    cell_2, cell_3 = source[at + np.uint64(2)], source[at + np.uint64(3)]
    cell_4, cell_5 = source[at + np.uint64(4)], source[at + np.uint64(5)]
    cell_6, cell_7 = source[at + np.uint64(6)], source[at + np.uint64(7)]
    target[target_at], target[target_at + np.uint64(1)] = cell_0, cell_1
    target[target_at + np.uint64(2)], target[target_at + np.uint64(3)] = cell_2, cell_3
    target[target_at + np.uint64(4)], target[target_at + np.uint64(5)] = cell_4, cell_5
    target[target_at + np.uint64(6)], target[target_at + np.uint64(7)] = cell_6, cell_7


@jit
def clear(image: Array, i: int, plane: int) -> None:
    """Set a plane of agent `i` to 0."""
    for j in range(image.shape[2]):
        image[i, plane, j] = 0.0


@jit
def mark(
    height: int, width: int, corners: Array, own: Array, stride: Array, turn: int, corner: int, cell: int,
    image: Array, i: int, plane: int
) -> None:  # fmt: skip
    """Write 1 to the cell of agent `i`'s view that shows the map's `cell`, if there is one.

    `height` and `width` are those of the view; `corners`, `own` and `stride` are fields of `MapLayers`.
    """
    ahead = corners[cell, turn] + own[turn] - np.int64(corner)
    if ahead >= 0:
        # Both numbers are below 2^32, which are divided faster.
        row = np.int64(np.uint32(ahead) // np.uint32(stride[turn]))
        col = ahead - row * stride[turn]
        if row < height and col < width:
            image[i, plane, row * width + col] = 1.0
