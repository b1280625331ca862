"""The channels for which every cell in view, or every agent in it, is looked up; and what walls hide.

A kernel draws one channel for all agents of one environment: `image` (N, K, V) float32, `V = h * w` cells of the view,
from plane number `plane` on. What the other arrays hold is said in `core/observation/layers.py`, `core/observation/inputs.py` and
`core/state.py`; they are those of the environment, and of its map.
"""

from __future__ import annotations

import numpy as np

from mapf_pz.core.cost_to_go import next_cell
from mapf_pz.core.jit import jit
from mapf_pz.core.observation.layers import MapLayers, ViewOrigins, ViewShape, clear, mark
from mapf_pz.core.state import Array


@jit
def draw_goal(
    view_shape: ViewShape, layers: MapLayers, origins: ViewOrigins, agents: Array, image: Array, plane: int
) -> None:
    """1 on the agent's own goal."""
    for i in range(image.shape[0]):
        clear(image, i, plane)
        mark(view_shape, layers, origins, agents[i].goal, image, i, plane)


@jit
def draw_cost_to_go(
    slot: Array, to_go: Array, nearest: Array, scale: float, agents: Array, cells: Array, image: Array, plane: int
) -> None:
    """How much nearer to the goal each cell is: `clip((D_own - D) / scale, -1, 1)`, `scale = (h + w) * mean weight`.

    `D` is the least cost to go over headings, `D_own` the observer's own; -1 where there is no path.
    """
    for i in range(image.shape[0]):
        table = slot[agents[i].goal]
        own = to_go[table, agents[i].cell, agents[i].heading & (to_go.shape[2] - 1)]
        costs, shown = nearest[table], image[i, plane]
        for j in range(shown.size):
            shown[j] = costs[cells[i, j]]
        if own == np.inf:  # and so it may be everywhere, of which the difference is no number
            own = -np.inf
        for j in range(shown.size):
            shown[j] = min(max((own - shown[j]) / scale, -1.0), 1.0)


@jit
def draw_heuristic(
    view_shape: ViewShape,
    slot: Array,
    nearest: Array,
    leads_to: Array,
    turn: Array,
    agents: Array,
    cells: Array,
    image: Array,
    plane: int,
) -> None:
    """1 where leaving the cell in that direction leads nearer to the goal (the channels of DHC, Ma et al., 2021)."""
    for i in range(image.shape[0]):
        table = slot[agents[i].goal]
        for k in range(4):
            towards = (turn[i] + k) % 4
            for j in range(cells.shape[1]):
                here = cells[i, j]
                image[i, plane + k, j] = 1.0 if nearest[table, leads_to[towards, here]] < nearest[table, here] else 0.0


@jit
def draw_others_cells(
    view_shape: ViewShape,
    layers: MapLayers,
    origins: ViewOrigins,
    count: Array,
    others: Array,
    marked: Array,
    image: Array,
    plane: int,
) -> None:
    """1 on the cells that belong to the other agents in view: `marked` (N,), the goals or next cells; -1: none."""
    for i in range(image.shape[0]):
        clear(image, i, plane)
        for k in range(count[i]):
            cell = marked[others[i, k]]
            if cell >= 0:
                mark(view_shape, layers, origins, cell, image, i, plane)


@jit
def find_next_cells(leads_to: Array, weight: Array, slot: Array, to_go: Array, agents: Array) -> None:
    """Set every agent's next cell on its own cheapest path."""
    for i in range(agents.size):
        agents[i].next_cell = next_cell(
            leads_to, weight, to_go[slot[agents[i].goal]], agents[i].cell, agents[i].heading
        )


@jit
def draw_others_at_goal(count: Array, positions: Array, others: Array, agents: Array, image: Array, plane: int) -> None:
    """On each other agent in view 1 if it is on its goal, else -1."""
    for i in range(image.shape[0]):
        clear(image, i, plane)
        for k in range(count[i]):
            other = agents[others[i, k]]
            image[i, plane, positions[i, k]] = 1.0 if other.cell == other.goal else -1.0


@jit
def hide(seen: Array, image: Array, plane: int, unseen: float) -> None:
    """Write `unseen` where an obstacle hides the cell."""
    for i in range(image.shape[0]):
        for j in range(image.shape[2]):
            if not seen[i, j]:
                image[i, plane, j] = unseen
