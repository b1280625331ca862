"""The layers of a map: arrays from which each agent's view is copied, row by row.

For egocentric views each map is stored four times, rotated so that each heading is up in one of them; otherwise once,
with north up. A margin around it is as wide as views extend beyond the map. What never changes during an episode is
drawn when the map is set; agents are drawn before an environment is observed, and erased afterwards.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapf_pz._internal.jit import Array, inlined, jit
from mapf_pz.instances.heading import HEADING_STEPS, Heading

OCCUPANCY, HEADING, EDGES, GOAL = range(4)
"""What built-in channels show of the map: 1 on obstacles and 0.5 on agents; `(1 + k) / 4` on agents of heading `k`;
weights of edges in four planes; and each agent's own goal, which is not in the layers but drawn into its view."""

FREE, AGENT, OBSTACLE = 0, 1, 5
"""What is in a cell: the first three bits of its byte. `AGENT + k` is an agent of heading `k`."""
_KIND, _OPEN_BIT, _INSIDE_BIT = 7, 3, 7
"""The mask of these bits, and the places of the next: four for the edges that are open, one in cells of the map."""
_CACHED_BYTES = 2**19
"""Size up to which edges of weight 1 are stored as numbers, too: copying from the cache is faster than decoding."""
_VIEWS = 16
"""Number of views that are decoded together, in long loops of vector instructions."""


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
    """M maps of C cells in R rotations: S entries in all, rotation by rotation and row by row, with a margin."""

    num_threads: int  # T
    stride: Array  # (R,) int32: the length of a row
    own: Array  # (R,) int32: index of the observer minus that of its view's first cell
    place: Array  # (C, R) int32: index of each map cell
    cell: Array  # (S,) uint32: the map cell at each entry; the number C in the margin
    contents: Array  # (X, S) uint8: the contents and the blocked edges of each cell
    edges: Array  # (M, 4, S) float32: weights of edges; (M, 0, S) if they are not observed, or decoded from `contents`
    windows: Array  # (T, A, V') uint8: scratch, the contents of A views; V' is V rounded up to a multiple of 32
    values: Array  # (T, A, V') float32: scratch, what a plane shows of them
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
    view_shape: ViewShape, shape: tuple[int, int], num_maps: int, num_threads: int, with_edges: bool, unit_weights: bool
) -> MapLayers:
    """Make room for maps of `shape` (H, W), and number their places.

    `with_edges`: edges are observed; `unit_weights`: all of their weights are 1. Raises `ValueError` if the maps with
    their margins have too many cells to be numbered.
    """
    padded_cells = (max(shape) + view_shape.height) * (max(shape) + view_shape.width) * view_shape.num_turns
    if padded_cells > np.iinfo(np.int32).max:
        raise ValueError(f"view_size={view_shape.height, view_shape.width}: too large for a map of {shape} cells")
    map_rows, map_cols = np.indices(shape).reshape(2, -1)
    stride, places, size = [], [], 0
    for up in Heading if view_shape.num_turns > 1 else (Heading.NORTH,):
        (down, right), (turned_down, turned_right) = HEADING_STEPS[up], HEADING_STEPS[(up + 1) % 4]
        rows, cols = -(map_rows * down + map_cols * right), map_rows * turned_down + map_cols * turned_right
        rows, cols = rows - rows.min(), cols - cols.min()
        stride.append(cols.max() + view_shape.width)
        own = view_shape.row * stride[-1] + view_shape.column
        places.append(size + rows * stride[-1] + cols + own)
        size += (rows.max() + view_shape.height) * stride[-1]
    is_small = num_maps * 4 * size * np.float32().nbytes <= _CACHED_BYTES
    padded = -(-view_shape.height * view_shape.width // 32) * 32
    layers = MapLayers(
        num_threads=num_threads,
        stride=np.array(stride, np.int32),
        own=(view_shape.row * np.array(stride) + view_shape.column).astype(np.int32),
        place=np.stack(places, axis=1).astype(np.int32),
        cell=np.full(size, map_rows.size, np.uint32),
        contents=np.full((num_threads if num_maps == 1 else num_maps, size), OBSTACLE, np.uint8),
        edges=np.zeros((num_maps, 4 if with_edges and (not unit_weights or is_small) else 0, size), np.float32),
        windows=np.zeros((num_threads, _VIEWS, padded), np.uint8),
        values=np.zeros((num_threads, _VIEWS, padded), np.float32),
        shared=num_maps == 1,
    )
    for place in layers.place.T:
        layers.cell[place] = np.arange(map_rows.size)
    return layers


def draw_map(layers: MapLayers, m: int, weight: Array, obstacle: Array) -> None:
    """Draw map `m`: obstacles (C + 1,), and the weights of edges (5, C + 1) over the largest finite one."""
    contents = layers.contents if layers.shared else layers.contents[m : m + 1]
    _draw_map(layers.place, weight, obstacle, contents, layers.edges[m])


@jit
def _draw_map(place: Array, weight: Array, obstacle: Array, contents: Array, edges: Array) -> None:
    largest = _largest(weight) if edges.shape[0] else 1.0
    for cell in range(place.shape[0]):
        is_open, kind = 0, OBSTACLE if obstacle[cell] > 0 else FREE
        for towards in range(4):
            is_open |= (weight[towards, cell] < np.inf) << towards
        for turn in range(place.shape[1]):
            # The first edge is in the direction of the turn, or to the east.
            at, turned = place[cell, turn], (is_open | is_open << 4) >> turn & 15
            for copy in range(contents.shape[0]):
                contents[copy, at] = kind | turned << _OPEN_BIT | 1 << _INSIDE_BIT
            for k in range(edges.shape[0]):
                cost = weight[(turn + k) % 4, cell]
                edges[k, at] = cost / largest if cost < np.inf else -1.0


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
    corner: Array  # (B, N) uint32: index of the first cell


def allocate_origins(num_envs: int, num_agents: int) -> ViewOrigins:
    """Make room for B x N agents."""
    each = (num_envs, num_agents)
    return ViewOrigins(np.zeros(each, np.uint32), np.zeros(each, np.uint32))


@inlined
def draw_agents(view_shape: ViewShape, layers: MapLayers, origins: ViewOrigins, agents: Array, contents: Array) -> None:
    """Set where each agent's view is copied from, and draw active agents on `contents` (S,)."""
    num_turns = view_shape.num_turns
    for i in range(agents.size):
        agent = agents[i]
        cell, heading = np.uint32(agent.cell), np.uint32(agent.heading)
        own_turn = heading if num_turns > 1 else np.uint32(0)
        origins.turn[i] = own_turn
        origins.corner[i] = layers.place[cell, own_turn] - layers.own[own_turn]
        if agent.active:
            for turn in range(num_turns):
                contents[np.uint32(layers.place[cell, turn])] |= AGENT + (heading - np.uint32(turn) & 3)


@inlined
def heading_value(turn: int, heading: int) -> np.float32:
    """Return how a heading is shown where `turn` is up: `(1 + k) / 4`."""
    return np.float32(1 + ((heading - turn) & 3)) * np.float32(0.25)


@inlined
def erase_agents(view_shape: ViewShape, layers: MapLayers, agents: Array, contents: Array) -> None:
    """Erase the agents that `draw_agents` drew."""
    for i in range(agents.size):
        if agents[i].active:
            for turn in range(view_shape.num_turns):
                contents[np.uint32(layers.place[np.uint32(agents[i].cell), turn])] &= 255 - _KIND


@inlined
def copy_contents(
    rows: Span, columns: Span, stride: Array, origins: ViewOrigins, contents: Array, windows: Array, values: Array,
    view_at: int, orientation_at: int, edges_at: int, image: Array
) -> None:  # fmt: skip
    """Decode each agent's view of `contents` (S,) to planes of the image (N, K, V), except where their number is -1.

    `edges_at` is the first plane of edges of weight 1; `windows` and `values` (A, V') are scratch.
    """
    kinds, numbers, target = windows.reshape(-1), values.reshape(-1), image.reshape(-1)
    for first in range(0, image.shape[0], windows.shape[0]):
        last = min(first + windows.shape[0], image.shape[0])
        size = (last - first) * windows.shape[1]
        for i in range(first, last):
            step, at = np.uint64(stride[np.uint64(origins.turn[i])]), np.uint64((i - first) * windows.shape[1])
            _copy_rows(rows, columns, contents, np.uint64(origins.corner[i]), step, kinds, at)
        if view_at >= 0:
            for j in range(size):
                kind = kinds[j] & _KIND
                numbers[j] = np.float32(1.0) if kind == OBSTACLE else np.float32(0.5 if kind > FREE else 0.0)
            _copy_values(rows, columns, values, target, image.shape[1], view_at, first, last)
        if orientation_at >= 0:
            for j in range(size):
                kind = kinds[j] & _KIND
                numbers[j] = np.float32(0.0) if kind == OBSTACLE else np.float32(kind) * np.float32(0.25)
            _copy_values(rows, columns, values, target, image.shape[1], orientation_at, first, last)
        for k in range(4 if edges_at >= 0 else 0):
            for j in range(size):  # 1 for open edges, -1 for blocked ones, 0 outside of the map
                twice_open = kinds[j] >> (_OPEN_BIT - 1 + k) & 2
                numbers[j] = np.float32(np.int8(twice_open - (kinds[j] >> _INSIDE_BIT)))
            _copy_values(rows, columns, values, target, image.shape[1], edges_at + k, first, last)


@inlined
def _copy_values(
    rows: Span, columns: Span, values: Array, target: Array, num_planes: int, plane: int, first: int, last: int
) -> None:  # fmt: skip
    """Copy the values of the agents from `first` to before `last` to a plane of theirs."""
    source, num_cells, width = values.reshape(-1), np.uint64(len(rows) * len(columns)), np.uint64(len(columns))
    for i in range(first, last):
        at = np.uint64((i - first) * values.shape[1])
        _copy_rows(rows, columns, source, at, width, target, np.uint64(i * num_planes + plane) * num_cells)


@inlined
def _copy_rows(
    rows: Span, columns: Span, source: Array, at: np.uint64, step: np.uint64, target: Array, target_at: np.uint64
) -> None:
    """Copy the rows of one view, which are `step` entries apart in the source."""
    for _ in range(len(rows)):
        _copy_row(columns, source, at, target, target_at)
        at += step
        target_at += np.uint64(len(columns))


@inlined
def copy_edges(
    rows: Span, columns: Span, stride: Array, origins: ViewOrigins, edges: Array, edges_at: int, image: Array
) -> None:  # fmt: skip
    """Copy each agent's view of `edges` (4, S) to the planes of the image (N, K, V) from `edges_at` on."""
    source, target = edges.reshape(-1), image.reshape(-1)
    size, num_drawn = np.uint64(edges.shape[1]), np.uint64(image.shape[1])
    num_cells = np.uint64(len(rows) * len(columns))
    for i in range(image.shape[0]):
        step = np.uint64(stride[np.uint64(origins.turn[i])])
        target_at = (np.uint64(i) * num_drawn + np.uint64(edges_at)) * num_cells
        for k in range(4):
            at = np.uint64(k) * size + np.uint64(origins.corner[i])
            _copy_rows(rows, columns, source, at, step, target, target_at + np.uint64(k) * num_cells)


@jit
def _copy_row(columns: Span, source: Array, at: np.uint64, target: Array, target_at: np.uint64) -> None:
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
def _copy_four(source: Array, at: np.uint64, target: Array, target_at: np.uint64) -> None:
    """Copy four cells: all are read before any is written, or the compiler could not take them at once."""
    cell_0, cell_1 = source[at], source[at + np.uint64(1)]
    cell_2, cell_3 = source[at + np.uint64(2)], source[at + np.uint64(3)]
    target[target_at], target[target_at + np.uint64(1)] = cell_0, cell_1
    target[target_at + np.uint64(2)], target[target_at + np.uint64(3)] = cell_2, cell_3


@jit
def _copy_eight(source: Array, at: np.uint64, target: Array, target_at: np.uint64) -> None:
    """Copy eight cells in the same way."""
    cell_0, cell_1 = source[at], source[at + np.uint64(1)]
    cell_2, cell_3 = source[at + np.uint64(2)], source[at + np.uint64(3)]
    cell_4, cell_5 = source[at + np.uint64(4)], source[at + np.uint64(5)]
    cell_6, cell_7 = source[at + np.uint64(6)], source[at + np.uint64(7)]
    target[target_at], target[target_at + np.uint64(1)] = cell_0, cell_1
    target[target_at + np.uint64(2)], target[target_at + np.uint64(3)] = cell_2, cell_3
    target[target_at + np.uint64(4)], target[target_at + np.uint64(5)] = cell_4, cell_5
    target[target_at + np.uint64(6)], target[target_at + np.uint64(7)] = cell_6, cell_7
