"""The looked-up channels: those that are drawn by looking up every cell in view, or every agent in it.

A kernel draws all of them that are observed, one environment after another, with the cells of a view in one axis:
(B, N, K, V), `V = h * w`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import prange

from mapf_pz._internal.jit import Array, BatchKernel, inlined, jit
from mapf_pz.simulator.kernels.cost_lookup import ALL_EXCESS, LEAST_BIT, cost_at, least_cost_at, next_cell
from mapf_pz.simulator.kernels.observation.inputs import NO_DISTANCES, NO_OTHERS, ObservationInputs
from mapf_pz.simulator.kernels.state import CostToGo


class LookupPlanes(NamedTuple):
    """The first plane of each looked-up channel in the image; -1: not drawn."""

    cost_to_go: int
    heuristic: int
    other_goals: int
    others_next: int
    others_heuristic: int
    others_at_goal: int
    others_delayed: int


def draw_lookups(inputs: ObservationInputs, planes: LookupPlanes, image: Array) -> None:
    """Draw the looked-up channels to `image` (B, N, K, V) float32."""
    shape, layers, world, state = inputs.view_shape, inputs.layers, inputs.world, inputs.state
    of_others = set(LookupPlanes._fields) - {"cost_to_go", "heuristic"}
    shows_others = max(getattr(planes, name) for name in of_others) >= 0
    others = inputs.others if shows_others else NO_OTHERS
    # Single arrays, since a named tuple takes longer to pass to a kernel.
    geometry = (shape.height, shape.width, layers.place, layers.stride, *inputs.origins)
    distances = inputs.distances if inputs.has_distances else NO_DISTANCES
    tables = (world.leads_to, world.weight, world.mean_weight, *distances[1:], state.map, state.agents)
    _draw_lookups(inputs.num_threads, *geometry, inputs.cells, *others, *tables, *planes, image)


@BatchKernel
def _draw_lookups(
    height: int, width: int, place: Array, stride: Array, turn: Array, corner: Array, cells: Array,
    count: Array, spots: Array, others: Array, leads_to: Array, weight: Array, mean_weight: Array,
    packed: Array, exact: Array, least: Array, maps: Array, all_agents: Array, cost_to_go: int, heuristic: int,
    other_goals: int, others_next: int, others_heuristic: int, others_at_goal: int, others_delayed: int,
    all_images: Array
) -> None:  # fmt: skip
    to_go = CostToGo(packed, exact, least)
    for b in prange(maps.size):
        m, agents, image = maps[b], all_agents[b], all_images[b]
        geometry = (height, width, place, stride, turn[b], corner[b])
        if cost_to_go >= 0:
            scale = (height + width) * mean_weight[m]
            _draw_cost_to_go(to_go, scale, agents, cells[b], image, cost_to_go)
        if heuristic >= 0:
            _draw_heuristic(to_go, leads_to[m], turn[b], agents, cells[b], image, heuristic)
        if other_goals >= 0:
            _mark_cells(geometry, count[b], others[b], agents.goal, image, other_goals)
        if others_next >= 0:
            _find_next_cells(leads_to[m], weight[m], to_go, agents)
            _mark_cells(geometry, count[b], others[b], agents.next_cell, image, others_next)
        if others_heuristic >= 0:
            _find_closer_directions(leads_to[m], to_go, agents)
            _draw_others_heuristic(turn[b], count[b], spots[b], others[b], agents, image, others_heuristic)
        if others_at_goal >= 0:
            _draw_others_at_goal(count[b], spots[b], others[b], agents, image, others_at_goal)
        if others_delayed >= 0:
            _draw_others_delayed(count[b], spots[b], others[b], agents, image, others_delayed)


@jit
def _draw_cost_to_go(to_go: CostToGo, scale: float, agents: Array, cells: Array, image: Array, plane: int) -> None:
    """How much closer to the goal each cell is: `clip((D_own - D) / scale, -1, 1)`, `scale = (h + w) * mean weight`.

    `D` is the least cost to go over headings, `D_own` the observer's own; -1 where there is no path.
    """
    for i in range(image.shape[0]):
        table = agents[i].table
        own = cost_at(to_go, table, agents[i].cell, agents[i].heading)
        shown = image[i, plane]
        if to_go.packed.shape[0] > 0:
            steps = to_go.packed[table]  # 32 bits are kept all along, for vector instructions
            for j in range(shown.size):
                shown[j] = np.int32(steps[cells[i, j]] >> LEAST_BIT)  # very large where there is no path
        else:
            costs = to_go.least[table]
            for j in range(shown.size):
                shown[j] = costs[cells[i, j]]
        if own == np.inf:  # then all costs may be infinite, and their difference is not a number
            own = -np.inf
        for j in range(shown.size):
            shown[j] = min(max((own - shown[j]) / scale, -1.0), 1.0)


@jit
def _draw_heuristic(
    to_go: CostToGo, leads_to: Array, turn: Array, agents: Array, cells: Array, image: Array, plane: int
) -> None:
    """1 where leaving the cell in that direction leads closer to the goal (the channels of DHC, Ma et al., 2021)."""
    for i in range(image.shape[0]):
        table = agents[i].table
        for k in range(4):
            towards = (turn[i] + k) % 4
            shown = image[i, plane + k]
            if to_go.packed.shape[0] > 0:
                steps = to_go.packed[table]
                for j in range(shown.size):
                    here = cells[i, j]
                    there = steps[leads_to[towards, here]] | ALL_EXCESS  # then packed numbers sort by the least cost
                    shown[j] = 1.0 if there < steps[here] else 0.0
            else:
                costs = to_go.least[table]
                for j in range(shown.size):
                    here = cells[i, j]
                    shown[j] = 1.0 if costs[leads_to[towards, here]] < costs[here] else 0.0


@jit
def _mark_cells(geometry: tuple[Any, ...], count: Array, others: Array, cells: Array, image: Array, plane: int) -> None:
    """Write 1 to the cell (N,) of each other agent in view, unless it is -1, and 0 elsewhere."""
    height, width, place, stride, turn, corner = geometry
    for i in range(image.shape[0]):
        clear(image, i, plane)
        for k in range(count[i]):
            cell = cells[others[i, k]]
            if cell >= 0:
                mark(height, width, place, stride, turn[i], corner[i], cell, image, i, plane)


@jit
def _find_next_cells(leads_to: Array, weight: Array, to_go: CostToGo, agents: Array) -> None:
    """Set each agent's next cell on its own cheapest path."""
    for i in range(agents.size):
        agents[i].next_cell = next_cell(leads_to, weight, to_go, agents[i].table, agents[i].cell, agents[i].heading)


@jit
def _find_closer_directions(leads_to: Array, to_go: CostToGo, agents: Array) -> None:
    """Set each agent's bits of the directions that lead closer to its goal."""
    for i in range(agents.size):
        table, cell = agents[i].table, agents[i].cell
        here, bits = least_cost_at(to_go, table, cell), 0
        for towards in range(4):
            if least_cost_at(to_go, table, leads_to[towards, cell]) < here:
                bits |= 1 << towards
        agents[i].closer = bits


@jit
def _draw_others_heuristic(
    turn: Array, count: Array, spots: Array, others: Array, agents: Array, image: Array, plane: int
) -> None:
    """On each other agent in view, 1 where a move in that direction leads closer to that agent's goal."""
    for i in range(image.shape[0]):
        for k in range(4):
            clear(image, i, plane + k)
            towards = (turn[i] + k) % 4
            for j in range(count[i]):
                image[i, plane + k, spots[i, j]] = agents[others[i, j]].closer >> towards & 1


@jit
def _draw_others_at_goal(count: Array, spots: Array, others: Array, agents: Array, image: Array, plane: int) -> None:
    """On each other agent in view 1 if it is on its goal, otherwise -1."""
    for i in range(image.shape[0]):
        clear(image, i, plane)
        for k in range(count[i]):
            other = agents[others[i, k]]
            image[i, plane, spots[i, k]] = 1.0 if other.cell == other.goal else -1.0


@jit
def _draw_others_delayed(count: Array, spots: Array, others: Array, agents: Array, image: Array, plane: int) -> None:
    """On each other agent in view 1 if it was delayed in the last step, otherwise -1."""
    for i in range(image.shape[0]):
        clear(image, i, plane)
        for k in range(count[i]):
            image[i, plane, spots[i, k]] = 1.0 if agents[others[i, k]].delayed else -1.0


@inlined
def clear(image: Array, i: int, plane: int) -> None:
    """Set a plane of agent `i` to 0."""
    for j in range(image.shape[2]):
        image[i, plane, j] = 0.0


@inlined
def mark(
    height: int, width: int, place: Array, stride: Array, turn: int, corner: int, cell: int,
    image: Array, i: int, plane: int
) -> None:  # fmt: skip
    """Write 1 to the cell of agent `i`'s view that shows the map's `cell`, if there is one.

    `height` and `width` are those of the view; `place` and `stride` are fields of `MapLayers`.
    """
    ahead = np.int64(place[cell, turn]) - np.int64(corner)
    if ahead >= 0:
        # Both numbers are below 2^32, which are divided faster.
        row = np.int64(np.uint32(ahead) // np.uint32(stride[turn]))
        col = ahead - row * stride[turn]
        if row < height and col < width:
            image[i, plane, row * width + col] = 1.0
