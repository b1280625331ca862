"""What all agents observe, drawn for one environment after the other.

First the windows of the stage and the goal, then whatever else must be looked up. The latter needs more arrays, each of
which takes time to be handed to a kernel, so that they are left out where nothing asks for them.
"""

from __future__ import annotations

import numpy as np
from numba import prange

from mapf_pz.core import lookups
from mapf_pz.core.channels import Planes
from mapf_pz.core.jit import BatchKernel, jit
from mapf_pz.core.scene import Notes, Scene, note_cells, note_others, note_seen
from mapf_pz.core.stage import Sight, Span, Stage, Windows, cut, enter, facing, leave
from mapf_pz.core.state import Array, Distances, State, World


def observe(num_threads: int, scene: Scene, planes: Planes, image: Array) -> None:
    """Fill `image` (B, N, K, V) float32."""
    state, places = scene.state, (planes.shown, planes.drawn, planes.view_at, planes.goal_at, planes.orientation_at)
    geometry = (scene.sight, scene.rows, scene.columns, scene.stage, *scene.windows)
    _draw_windows(num_threads, *geometry, *places, state.map, state.agents, image)
    if planes.look_up or not scene.sight.see_through_walls:
        seen = (scene.notes, scene.world, scene.distances, state)
        _draw_lookups(num_threads, *geometry, *seen, planes, image)


@BatchKernel
def _draw_windows(
    sight: Sight, rows: Span, columns: Span, stage: Stage, turn: Array, corner: Array, shown: Array, drawn: Array,
    view_at: int, goal_at: int, orientation_at: int, maps: Array, agents: Array, image: Array
) -> None:  # fmt: skip
    """Draw the windows of the stage, and the goal."""
    for thread in prange(stage.num_threads):
        for b in range(thread, maps.size, stage.num_threads):
            planes = stage.planes[np.int64(thread) if stage.shared else maps[b]]
            windows, crew, pictures = Windows(turn[b], corner[b]), agents[b], image[b]
            enter(sight, stage, windows, crew, planes)
            cut(rows, columns, stage.stride, windows, planes, shown, pictures, drawn)
            leave(sight, stage, crew, planes)
            _draw_observers(sight, windows.turn, crew, pictures, view_at, orientation_at)
            if goal_at >= 0:
                lookups.draw_goal(sight, stage, windows, crew, pictures, goal_at)


@jit
def _draw_observers(sight: Sight, turn: Array, crew: Array, image: Array, view_at: int, orientation_at: int) -> None:
    """Take observers out of their own views; but let each see its own heading, also in the step in which it retires."""
    here = sight.row * sight.width + sight.column
    for i in range(crew.size):
        if view_at >= 0:
            image[i, view_at, here] = 0.0
        if orientation_at >= 0:
            image[i, orientation_at, here] = facing(turn[i], crew[i].heading)


@BatchKernel
def _draw_lookups(
    sight: Sight, rows: Span, columns: Span, stage: Stage, turn: Array, corner: Array, notes: Notes, world: World,
    distances: Distances, state: State, planes: Planes, image: Array
) -> None:  # fmt: skip
    """Draw the channels for which cells are looked up, and hide what walls hide."""
    for thread in prange(stage.num_threads):
        for b in range(thread, image.shape[0], stage.num_threads):
            windows = Windows(turn[b], corner[b])
            note_cells(rows, columns, stage, windows, notes.cells[thread])
            _draw_lookups_of(sight, stage, windows, notes, world, distances, state, planes, thread, b, image[b])


@jit
def _draw_lookups_of(
    sight: Sight, stage: Stage, windows: Windows, notes: Notes, world: World, distances: Distances,
    state: State, planes: Planes, thread: int, b: int, image: Array
) -> None:  # fmt: skip
    """Draw them for one environment."""
    m, crew = state.map[b], state.agents[b]
    slot, to_go, nearest = distances.slot[m], distances.to_go, distances.nearest
    cells, seen = notes.cells[thread], notes.seen[thread]
    count, spots, others = notes.count[thread], notes.spots[thread], notes.others[thread]
    if not sight.see_through_walls:
        note_seen(sight, world.obstacle[m], cells, seen)
        if planes.view_at >= 0:
            lookups.hide(seen, image, planes.view_at, -1.0)
        if planes.orientation_at >= 0:
            lookups.hide(seen, image, planes.orientation_at, 0.0)
    if planes.cost_to_go_at >= 0:
        scale = (sight.height + sight.width) * world.mean_weight[m]
        lookups.draw_cost_to_go(slot, to_go, nearest, scale, crew, cells, image, planes.cost_to_go_at)
    if planes.heuristic_at >= 0:
        leads_to, at = world.leads_to[m], planes.heuristic_at
        lookups.draw_heuristic(sight, slot, nearest, leads_to, windows.turn, crew, cells, image, at)
    if planes.other_goals_at >= 0 or planes.others_next_at >= 0 or planes.others_at_goal_at >= 0:
        note_others(state.occupant[b], cells, seen, count, spots, others)
    if planes.other_goals_at >= 0:
        at = planes.other_goals_at
        lookups.draw_others_cells(sight, stage, windows, count, others, crew.goal, image, at)
    if planes.others_next_at >= 0:
        lookups.find_next_cells(world.leads_to[m], world.weight[m], slot, to_go, crew)
        at = planes.others_next_at
        lookups.draw_others_cells(sight, stage, windows, count, others, crew.next_cell, image, at)
    if planes.others_at_goal_at >= 0:
        lookups.draw_others_at_goal(count, spots, others, crew, image, planes.others_at_goal_at)
