"""The functions that draw the built-in channels, except those that show layers of the map.

Each takes the `inputs`, all agents' `image` (B, N, K, h, w) float32 and the number of its first plane. The kernels work
on one environment after another, with the cells of a view in one axis: (B, N, K, V), `V = h * w`.
"""

from __future__ import annotations

import numpy as np
from numba import prange

from mapf_pz.core.cost_to_go import next_cell
from mapf_pz.core.jit import BatchKernel, jit
from mapf_pz.core.observation.inputs import ObservationInputs
from mapf_pz.core.observation.layers import MapLayers, ViewShape, clear, mark
from mapf_pz.core.state import Array


def _flat(image: Array) -> Array:
    return image.reshape(*image.shape[:3], -1)


def draw_goal(inputs: ObservationInputs, image: Array, plane: int) -> None:
    """1 on the agent's own goal."""
    geometry = (inputs.view_shape, inputs.layers, *inputs.origins)
    _draw_goal(inputs.num_threads, *geometry, inputs.state.agents, _flat(image), plane)


@BatchKernel
def _draw_goal(
    view_shape: ViewShape, layers: MapLayers, turn: Array, corner: Array, agents: Array, image: Array, plane: int
) -> None:
    for b in prange(image.shape[0]):
        for i in range(image.shape[1]):
            clear(image[b], i, plane)
            mark(view_shape, layers, turn[b, i], corner[b, i], agents[b, i].goal, image[b], i, plane)


def draw_cost_to_go(inputs: ObservationInputs, image: Array, plane: int) -> None:
    """How much closer to the goal each cell is: `clip((D_own - D) / scale, -1, 1)`, `scale = (h + w) * mean weight`.

    `D` is the least cost to go over headings, `D_own` the observer's own; -1 where there is no path.
    """
    state, view_shape, cells = inputs.state, inputs.view_shape, inputs.cells
    scale = (view_shape.height + view_shape.width) * inputs.world.mean_weight.astype(np.float64)
    _draw_costs(inputs.num_threads, *inputs.distances, scale, state.map, state.agents, cells, _flat(image), plane)


@BatchKernel
def _draw_costs(
    slot: Array, to_go: Array, nearest: Array, scale: Array, maps: Array, agents: Array, cells: Array, image: Array,
    plane: int
) -> None:  # fmt: skip
    for b in prange(image.shape[0]):
        m = maps[b]
        _draw_costs_of(slot[m], to_go, nearest, scale[m], agents[b], cells[b], image[b], plane)


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
    _mark_of_others(inputs, inputs.state.agents["goal"], image, plane)


def draw_others_next(inputs: ObservationInputs, image: Array, plane: int) -> None:
    """1 on the cells that the other agents in view would enter next on their own cheapest paths."""
    world, state, distances = inputs.world, inputs.state, inputs.distances
    tables = (world.leads_to, world.weight, distances.slot, distances.to_go)
    _find_next_cells(inputs.num_threads, *tables, state.map, state.agents)
    _mark_of_others(inputs, state.agents["next_cell"], image, plane)


def _mark_of_others(inputs: ObservationInputs, cells: Array, image: Array, plane: int) -> None:
    """Write 1 to the cell (B, N) of each other agent in view, -1 for none, and 0 elsewhere."""
    others, geometry = inputs.others, (inputs.view_shape, inputs.layers, *inputs.origins)
    _mark_cells(inputs.num_threads, *geometry, others.count, others.agents, cells, _flat(image), plane)


@BatchKernel
def _mark_cells(
    view_shape: ViewShape, layers: MapLayers, turn: Array, corner: Array, count: Array, others: Array, cells: Array,
    image: Array, plane: int
) -> None:  # fmt: skip
    for b in prange(image.shape[0]):
        for i in range(image.shape[1]):
            clear(image[b], i, plane)
            for k in range(count[b, i]):
                cell = cells[b, others[b, i, k]]
                if cell >= 0:
                    mark(view_shape, layers, turn[b, i], corner[b, i], cell, image[b], i, plane)


@BatchKernel
def _find_next_cells(leads_to: Array, weight: Array, slot: Array, to_go: Array, maps: Array, all_agents: Array) -> None:
    for b in prange(maps.size):
        m = maps[b]
        _find_next_cells_of(leads_to[m], weight[m], slot[m], to_go, all_agents[b])


@jit
def _find_next_cells_of(leads_to: Array, weight: Array, slot: Array, to_go: Array, agents: Array) -> None:
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
