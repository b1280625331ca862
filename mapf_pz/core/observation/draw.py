"""The functions that draw the built-in channels, except those that show layers of the map.

Each takes the `inputs`, all agents' `image` (B, N, K, h, w) float32 and the number of its first plane. The kernels work
on one environment after another, with the cells of a view in one axis: (B, N, K, V), `V = h * w`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import prange

from mapf_pz.core.cost_to_go import next_cell
from mapf_pz.core.jit import BatchKernel, jit
from mapf_pz.core.observation.inputs import ObservationInputs
from mapf_pz.core.observation.layers import clear, mark
from mapf_pz.core.state import Array


def _flat(image: Array) -> Array:
    return image.reshape(*image.shape[:3], -1)


def draw_cost_to_go(inputs: ObservationInputs, image: Array, plane: int) -> None:
    """How much closer to the goal each cell is: `clip((D_own - D) / scale, -1, 1)`, `scale = (h + w) * mean weight`.

    `D` is the least cost to go over headings, `D_own` the observer's own; -1 where there is no path.
    """
    state, view_shape, weights = inputs.state, inputs.view_shape, inputs.world.mean_weight
    scale = view_shape.height + view_shape.width
    tables = (*inputs.distances, weights, scale, state.map, state.agents, inputs.cells)
    _draw_costs(inputs.num_threads, *tables, _flat(image), plane)


@BatchKernel
def _draw_costs(
    slot: Array, to_go: Array, nearest: Array, mean_weight: Array, scale: int, maps: Array, agents: Array,
    cells: Array, image: Array, plane: int
) -> None:  # fmt: skip
    for b in prange(image.shape[0]):
        m = maps[b]
        _draw_costs_of(slot[m], to_go, nearest, scale * mean_weight[m], agents[b], cells[b], image[b], plane)


@jit
def _draw_costs_of(
    slot: Array, to_go: Array, nearest: Array, scale: float, agents: Array, cells: Array, image: Array, plane: int
) -> None:
    for i in range(image.shape[0]):
        table = slot[agents[i].goal]
        own = to_go[table, agents[i].cell, agents[i].heading & (to_go.shape[2] - 1)]
        costs, shown = nearest[table], image[i, plane]
        for j in range(shown.size):
            shown[j] = costs[cells[i, j]]
        if own == np.inf:  # then all costs may be infinite, and their difference is not a number
            own = -np.inf
        for j in range(shown.size):
            shown[j] = min(max((own - shown[j]) / scale, -1.0), 1.0)


def draw_heuristic(inputs: ObservationInputs, image: Array, plane: int) -> None:
    """1 where leaving the cell in that direction leads closer to the goal (the channels of DHC, Ma et al., 2021)."""
    state, distances = inputs.state, inputs.distances
    tables = (distances.slot, distances.nearest, inputs.world.leads_to, inputs.origins.turn)
    _draw_heuristic(inputs.num_threads, *tables, state.map, state.agents, inputs.cells, _flat(image), plane)


@BatchKernel
def _draw_heuristic(
    slot: Array, nearest: Array, leads_to: Array, turn: Array, maps: Array, agents: Array, cells: Array, image: Array,
    plane: int
) -> None:  # fmt: skip
    for b in prange(image.shape[0]):
        m = maps[b]
        _draw_heuristic_of(slot[m], nearest, leads_to[m], turn[b], agents[b], cells[b], image[b], plane)


@jit
def _draw_heuristic_of(
    slot: Array, nearest: Array, leads_to: Array, turn: Array, agents: Array, cells: Array, image: Array, plane: int
) -> None:
    for i in range(image.shape[0]):
        table = slot[agents[i].goal]
        for k in range(4):
            towards = (turn[i] + k) % 4
            for j in range(cells.shape[1]):
                here = cells[i, j]
                image[i, plane + k, j] = 1.0 if nearest[table, leads_to[towards, here]] < nearest[table, here] else 0.0


def draw_other_goals(inputs: ObservationInputs, image: Array, plane: int) -> None:
    """1 on the goals of the other agents in view."""
    _draw_other_goals(inputs.num_threads, *_in_view(inputs), inputs.state.agents, _flat(image), plane)


def draw_others_next(inputs: ObservationInputs, image: Array, plane: int) -> None:
    """1 on the cells that the other agents in view would enter next on their own cheapest paths."""
    world, state, distances = inputs.world, inputs.state, inputs.distances
    tables = (world.leads_to, world.weight, distances.slot, distances.to_go, state.map)
    _draw_others_next(inputs.num_threads, *tables, *_in_view(inputs), state.agents, _flat(image), plane)


def _in_view(inputs: ObservationInputs) -> tuple[Any, ...]:
    """Return the geometry of the views, and the other agents in each: what `_mark_cells` takes."""
    # Single arrays, since a named tuple takes longer to pass to a kernel.
    shape, layers, others = inputs.view_shape, inputs.layers, inputs.others
    geometry = (shape.height, shape.width, layers.corner, layers.own, layers.stride, *inputs.origins)
    return (*geometry, others.count, others.agents)


@BatchKernel
def _draw_other_goals(
    height: int, width: int, corners: Array, own: Array, stride: Array, turn: Array, corner: Array, count: Array,
    others: Array, agents: Array, image: Array, plane: int
) -> None:  # fmt: skip
    for b in prange(image.shape[0]):
        geometry = (height, width, corners, own, stride, turn[b], corner[b])
        _mark_cells(geometry, count[b], others[b], agents[b].goal, image[b], plane)


@BatchKernel
def _draw_others_next(
    leads_to: Array, weight: Array, slot: Array, to_go: Array, maps: Array, height: int, width: int, corners: Array,
    own: Array, stride: Array, turn: Array, corner: Array, count: Array, others: Array, agents: Array, image: Array,
    plane: int
) -> None:  # fmt: skip
    for b in prange(image.shape[0]):
        m = maps[b]
        _find_next_cells(leads_to[m], weight[m], slot[m], to_go, agents[b])
        geometry = (height, width, corners, own, stride, turn[b], corner[b])
        _mark_cells(geometry, count[b], others[b], agents[b].next_cell, image[b], plane)


@jit
def _mark_cells(geometry: tuple[Any, ...], count: Array, others: Array, cells: Array, image: Array, plane: int) -> None:
    """Write 1 to the cell (N,) of each other agent in view, unless it is -1, and 0 elsewhere."""
    height, width, corners, own, stride, turn, corner = geometry
    for i in range(image.shape[0]):
        clear(image, i, plane)
        for k in range(count[i]):
            cell = cells[others[i, k]]
            if cell >= 0:
                mark(height, width, corners, own, stride, turn[i], corner[i], cell, image, i, plane)


@jit
def _find_next_cells(leads_to: Array, weight: Array, slot: Array, to_go: Array, agents: Array) -> None:
    """Set each agent's next cell on its own cheapest path."""
    for i in range(agents.size):
        agents[i].next_cell = next_cell(
            leads_to, weight, to_go[slot[agents[i].goal]], agents[i].cell, agents[i].heading
        )


def draw_others_at_goal(inputs: ObservationInputs, image: Array, plane: int) -> None:
    """On each other agent in view 1 if it is on its goal, otherwise -1."""
    _draw_others_at_goal(inputs.num_threads, *inputs.others, inputs.state.agents, _flat(image), plane)


@BatchKernel
def _draw_others_at_goal(count: Array, spots: Array, others: Array, agents: Array, image: Array, plane: int) -> None:
    for b in prange(image.shape[0]):
        for i in range(image.shape[1]):
            clear(image[b], i, plane)
            _draw_agents_at_goal(count[b, i], spots[b, i], others[b, i], agents[b], image[b, i, plane])


@jit
def _draw_agents_at_goal(count: int, spots: Array, others: Array, agents: Array, view: Array) -> None:
    for k in range(count):
        other = agents[others[k]]
        view[spots[k]] = 1.0 if other.cell == other.goal else -1.0
