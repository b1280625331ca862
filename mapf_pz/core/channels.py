"""The channels of the image: each declares its planes and bounds, and has one kernel that draws them for one observer.

`image` (B * N * K, V) float32 holds one plane a row, `V = h * w` cells of the view; a channel begins at row `plane`.
`cells` (V,) uint32 holds the map cell under each cell of the view (the number `C` outside the map). The `count` other
agents in view are listed: `spots` (their place in the view) and `others` (their index in the crew). `first` is the
direction of the first of four planes: the observer's heading in the egocentric frame, east in the map frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mapf_pz.core.jit import jit
from mapf_pz.core.state import Array
from mapf_pz.core.world import STEPS


@dataclass(frozen=True)
class Channel:
    """What one channel adds to the image."""

    planes: int
    low: float
    high: float
    needs_distances: bool = False


CHANNELS: dict[str, Channel] = {
    "view": Channel(planes=1, low=-1, high=1),
    "goal": Channel(planes=1, low=0, high=1),
    "orientation": Channel(planes=1, low=0, high=1),
    "edge_weights": Channel(planes=4, low=-1, high=1),
    "cost_to_go": Channel(planes=1, low=-1, high=1, needs_distances=True),
    "heuristic": Channel(planes=4, low=0, high=1, needs_distances=True),
    "other_goals": Channel(planes=1, low=0, high=1),
    "others_next": Channel(planes=1, low=0, high=1, needs_distances=True),
    "others_at_goal": Channel(planes=1, low=-1, high=1),
}
"""All channels by name; `core/image.py` numbers them in this order."""

VIEW, GOAL, ORIENTATION, EDGE_WEIGHTS, COST_TO_GO, HEURISTIC, OTHER_GOALS, OTHERS_NEXT, OTHERS_AT_GOAL = range(9)


@jit
def clear(image: Array, plane: int) -> None:
    """Set a plane to 0."""
    for j in range(image.shape[1]):
        image[plane, j] = 0.0


@jit
def draw_view(
    obstacle: Array, m: int, cells: Array, seen: Array, spots: Array, count: int, image: Array, plane: int
) -> None:
    """0 free, 0.5 another agent, 1 obstacle or outside, -1 unseen."""
    for j in range(cells.size):
        image[plane, j] = obstacle[m, cells[j]] if seen[j] else -1.0
    for k in range(count):
        image[plane, spots[k]] = 0.5


@jit
def draw_goal(goal: int, cells: Array, image: Array, plane: int) -> None:
    """1 on the agent's own goal."""
    for j in range(cells.size):
        image[plane, j] = 1.0 if cells[j] == goal else 0.0


@jit
def draw_orientation(
    crew: Array, i: int, first: int, here: int, spots: Array, others: Array, count: int, image: Array, plane: int
) -> None:
    """On each agent in view, the observer (agent `i` at `here`) among them, `(1 + k) / 4` with `k` its heading."""
    clear(image, plane)
    image[plane, here] = (1 + (crew[i].heading - first) % 4) / 4
    for k in range(count):
        image[plane, spots[k]] = (1 + (crew[others[k]].heading - first) % 4) / 4


@jit
def draw_edge_weights(edge: Array, m: int, first: int, cells: Array, image: Array, plane: int) -> None:
    """Weight of leaving each cell in four directions over the largest; blocked -1, outside 0."""
    for k in range(4):
        towards = (first + k) % 4
        for j in range(cells.size):
            image[plane + k, j] = edge[m, towards, cells[j]]


@jit
def draw_cost_to_go(
    nearest: Array, slot: int, own: float, scale: float, cells: Array, image: Array, plane: int
) -> None:
    """`clip((own - nearest) / scale, -1, 1)`: how much nearer to the goal each cell is; -1 where it can't be reached."""
    for j in range(cells.size):
        nearer = (own - nearest[slot, cells[j]]) / scale
        image[plane, j] = min(max(nearer, -1.0), 1.0) if own < np.inf else -1.0


@jit
def draw_heuristic(
    nearest: Array, slot: int, leads_to: Array, m: int, first: int, cells: Array, image: Array, plane: int
) -> None:
    """1 where leaving the cell in that direction leads nearer to the goal (the channels of DHC, Ma et al., 2021)."""
    for k in range(4):
        towards = (first + k) % 4
        for j in range(cells.size):
            target = leads_to[m, towards, cells[j]]
            image[plane + k, j] = 1.0 if nearest[slot, target] < nearest[slot, cells[j]] else 0.0


@jit
def mark_cell(marked: int, cell: int, map_width: int, up: int, here: int, width: int, image: Array, plane: int) -> None:
    """Set the place of the map cell `marked` to 1 where it lies in the view of an observer on `cell`.

    `up` is the direction that is up in the view, `here` the observer's place in it and `width` the view's width.
    """
    down, right = STEPS[up]
    rows, cols = marked // map_width - cell // map_width, marked % map_width - cell % map_width
    row = here // width - (rows * down + cols * right)
    col = here % width + (rows * right - cols * down)
    if 0 <= row < image.shape[1] // width and 0 <= col < width:
        image[plane, row * width + col] = 1.0


@jit
def draw_others_at_goal(crew: Array, spots: Array, others: Array, count: int, image: Array, plane: int) -> None:
    """On each other agent in view 1 if it is on its goal, else -1."""
    clear(image, plane)
    for k in range(count):
        image[plane, spots[k]] = 1.0 if crew[others[k]].cell == crew[others[k]].goal else -1.0
