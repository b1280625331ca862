"""What all agents observe, drawn for one environment after the other.

First the origins of the layers and the goal, then whatever else must be looked up. The latter needs more arrays, each of
which takes time to be handed to a kernel, so that they are left out where nothing asks for them.
"""

from __future__ import annotations

import numpy as np
from numba import prange

from mapf_pz.core.jit import BatchKernel, jit
from mapf_pz.core.observation import draw as lookups
from mapf_pz.core.observation.channels import ChannelLayout
from mapf_pz.core.observation.inputs import ObservationInputs, ViewScratch, find_cells, find_others, find_visible
from mapf_pz.core.observation.layers import (
    MapLayers,
    Span,
    ViewOrigins,
    ViewShape,
    copy_windows,
    draw_agents,
    erase_agents,
    heading_value,
)
from mapf_pz.core.state import Array, Distances, State, World


def observe(num_threads: int, inputs: ObservationInputs, planes: ChannelLayout, image: Array) -> None:
    """Fill `image` (B, N, K, V) float32."""
    state, places = inputs.state, (planes.shown, planes.drawn, planes.view_at, planes.goal_at, planes.orientation_at)
    geometry = (inputs.view_shape, inputs.rows, inputs.columns, inputs.layers, *inputs.origins)
    _draw_windows(num_threads, *geometry, *places, state.map, state.agents, image)
    if planes.look_up or not inputs.view_shape.see_through_walls:
        seen = (inputs.scratch, inputs.world, inputs.distances, state)
        _draw_lookups(num_threads, *geometry, *seen, planes, image)


@BatchKernel
def _draw_windows(
    view_shape: ViewShape, rows: Span, columns: Span, layers: MapLayers, turn: Array, corner: Array, shown: Array, drawn: Array,
    view_at: int, goal_at: int, orientation_at: int, maps: Array, all_agents: Array, image: Array
) -> None:  # fmt: skip
    """Draw the origins of the layers, and the goal."""
    for thread in prange(layers.num_threads):
        for b in range(thread, maps.size, layers.num_threads):
            planes = layers.planes[np.int64(thread) if layers.shared else maps[b]]
            origins, agents, pictures = ViewOrigins(turn[b], corner[b]), all_agents[b], image[b]
            draw_agents(view_shape, layers, origins, agents, planes)
            copy_windows(rows, columns, layers.stride, origins, planes, shown, pictures, drawn)
            erase_agents(view_shape, layers, agents, planes)
            _draw_observers(view_shape, origins.turn, agents, pictures, view_at, orientation_at)
            if goal_at >= 0:
                lookups.draw_goal(view_shape, layers, origins, agents, pictures, goal_at)


@jit
def _draw_observers(
    view_shape: ViewShape, turn: Array, agents: Array, image: Array, view_at: int, orientation_at: int
) -> None:
    """Take observers out of their own views; but let each see its own heading, also in the step in which it retires."""
    here = view_shape.row * view_shape.width + view_shape.column
    for i in range(agents.size):
        if view_at >= 0:
            image[i, view_at, here] = 0.0
        if orientation_at >= 0:
            image[i, orientation_at, here] = heading_value(turn[i], agents[i].heading)


@BatchKernel
def _draw_lookups(
    view_shape: ViewShape, rows: Span, columns: Span, layers: MapLayers, turn: Array, corner: Array, scratch: ViewScratch, world: World,
    distances: Distances, state: State, planes: ChannelLayout, image: Array
) -> None:  # fmt: skip
    """Draw the channels for which cells are looked up, and hide what walls hide."""
    for thread in prange(layers.num_threads):
        for b in range(thread, image.shape[0], layers.num_threads):
            origins = ViewOrigins(turn[b], corner[b])
            find_cells(rows, columns, layers, origins, scratch.cells[thread])
            _draw_lookups_of(view_shape, layers, origins, scratch, world, distances, state, planes, thread, b, image[b])


@jit
def _draw_lookups_of(
    view_shape: ViewShape, layers: MapLayers, origins: ViewOrigins, scratch: ViewScratch, world: World, distances: Distances,
    state: State, planes: ChannelLayout, thread: int, b: int, image: Array
) -> None:  # fmt: skip
    """Draw them for one environment."""
    m, agents = state.map[b], state.agents[b]
    slot, to_go, nearest = distances.slot[m], distances.to_go, distances.nearest
    cells, seen = scratch.cells[thread], scratch.seen[thread]
    count, positions, others = scratch.count[thread], scratch.positions[thread], scratch.others[thread]
    if not view_shape.see_through_walls:
        find_visible(view_shape, world.obstacle[m], cells, seen)
        if planes.view_at >= 0:
            lookups.hide(seen, image, planes.view_at, -1.0)
        if planes.orientation_at >= 0:
            lookups.hide(seen, image, planes.orientation_at, 0.0)
    if planes.cost_to_go_at >= 0:
        scale = (view_shape.height + view_shape.width) * world.mean_weight[m]
        lookups.draw_cost_to_go(slot, to_go, nearest, scale, agents, cells, image, planes.cost_to_go_at)
    if planes.heuristic_at >= 0:
        leads_to, at = world.leads_to[m], planes.heuristic_at
        lookups.draw_heuristic(view_shape, slot, nearest, leads_to, origins.turn, agents, cells, image, at)
    if planes.other_goals_at >= 0 or planes.others_next_at >= 0 or planes.others_at_goal_at >= 0:
        find_others(state.occupant[b], cells, seen, count, positions, others)
    if planes.other_goals_at >= 0:
        at = planes.other_goals_at
        lookups.draw_others_cells(view_shape, layers, origins, count, others, agents.goal, image, at)
    if planes.others_next_at >= 0:
        lookups.find_next_cells(world.leads_to[m], world.weight[m], slot, to_go, agents)
        at = planes.others_next_at
        lookups.draw_others_cells(view_shape, layers, origins, count, others, agents.next_cell, image, at)
    if planes.others_at_goal_at >= 0:
        lookups.draw_others_at_goal(count, positions, others, agents, image, planes.others_at_goal_at)
