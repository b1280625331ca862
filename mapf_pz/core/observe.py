"""One observation: lay the view over the map, find the agents in it, then draw each channel and write each feature."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import prange

from mapf_pz.core import channels as ch
from mapf_pz.core import features as ft
from mapf_pz.core.conflict import NO_MOVE, direction
from mapf_pz.core.jit import jit, parallel_jit
from mapf_pz.core.path import find_next_cells
from mapf_pz.core.state import Array, Distances, State, World
from mapf_pz.types import Action, CardinalAction, Heading

_EAST, _NORTH = int(Heading.EAST), int(Heading.NORTH)
_WAIT, _CARDINAL_WAIT = int(Action.WAIT), int(CardinalAction.WAIT)


class Sight(NamedTuple):
    """The view's geometry, what is observed, and the scratch of B environments. `V = h * w` cells of the view."""

    height: int
    width: int
    here: int  # the observer's own place in the view
    egocentric: bool
    see_through_walls: bool
    cardinal: bool
    max_steps: int
    offsets: Array  # (4, V, 2) int32: (row, col) from the observer, for each direction that is up in the view
    steps: Array  # (4, 2) int32: the map step that leads one row up in the view
    planes: Array  # (number of channels,) int32: the channel's first plane; -1: not observed
    places: Array  # (number of features,) int32: where the feature's numbers begin; -1: not observed
    cells: Array  # (B, V) uint32: scratch
    seen: Array  # (B, V) bool: scratch; stays True where one sees through walls
    spots: Array  # (B, V) uint32: scratch
    others: Array  # (B, V) uint32: scratch


def _observe(
    sight: Sight, world: World, distances: Distances, state: State, image: Array, features: Array, mask: Array
) -> None:
    """Write what all agents observe: image (B * N * K, V), features (B * N, F), both float32, mask (B * N, A) int8."""
    num_agents = state.agents.shape[1]
    num_planes = image.shape[0] // (state.agents.size)
    for b in prange(state.time.size):
        m, crew = state.map[b], state.agents[b]
        if sight.planes[ch.OTHERS_NEXT] >= 0:
            find_next_cells(world, m, distances, crew)
        for i in range(num_agents):
            row = b * num_agents + i
            _write_mask(world.leads_to, m, sight.cardinal, crew[i], mask, row)
            if crew[i].was_active:
                _draw_image(sight, b, world, m, distances, state.occupant, crew, i, image, row * num_planes)
                _write_features(sight, b, world, m, distances, state, crew[i], i, features, row)
            else:
                image[row * num_planes : (row + 1) * num_planes] = 0.0
                features[row] = 0.0


@jit
def _draw_image(
    sight: Sight,
    b: int,
    world: World,
    m: int,
    distances: Distances,
    occupant: Array,
    crew: Array,
    i: int,
    image: Array,
    base: int,
) -> None:
    """Draw the planes of agent `i` of environment `b` to the rows of `image` from `base` on."""
    cells, seen, spots, others, planes = sight.cells[b], sight.seen[b], sight.spots[b], sight.others[b], sight.planes
    agent = crew[i]
    up = agent.heading if sight.egocentric else _NORTH
    first = agent.heading if sight.egocentric else _EAST
    down, right = sight.steps[up, 0], sight.steps[up, 1]
    _lay_view(world.height, world.width, agent.cell, sight.offsets, up, cells)
    if not sight.see_through_walls:
        _look(sight.here, sight.width, world.obstacle, m, cells, seen)
    count = _find_others(cells, seen, occupant, b, i, spots, others)

    if planes[ch.VIEW] >= 0:
        ch.draw_view(world.obstacle, m, cells, seen, spots, count, image, base + planes[ch.VIEW])
    if planes[ch.GOAL] >= 0:
        ch.draw_goal(agent.goal, cells, image, base + planes[ch.GOAL])
    if planes[ch.ORIENTATION] >= 0:
        plane = base + planes[ch.ORIENTATION]
        ch.draw_orientation(crew, i, first, sight.here, spots, others, count, image, plane)
    if planes[ch.EDGE_WEIGHTS] >= 0:
        ch.draw_edge_weights(world.edge, m, first, cells, image, base + planes[ch.EDGE_WEIGHTS])
    if planes[ch.COST_TO_GO] >= 0:
        slot = distances.slot[m, agent.goal]
        own = distances.to_go[slot, agent.cell, agent.heading % distances.to_go.shape[2]]
        scale = (sight.height + sight.width) * world.mean_weight[m]
        ch.draw_cost_to_go(distances.nearest, slot, own, scale, cells, image, base + planes[ch.COST_TO_GO])
    if planes[ch.HEURISTIC] >= 0:
        slot, plane = distances.slot[m, agent.goal], base + planes[ch.HEURISTIC]
        ch.draw_heuristic(distances.nearest, slot, world.leads_to, m, first, cells, image, plane)
    if planes[ch.OTHER_GOALS] >= 0:
        plane = base + planes[ch.OTHER_GOALS]
        image[plane] = 0.0
        for k in range(count):
            goal = crew[others[k]].goal
            ch.mark_cell(goal, agent.cell, world.width, down, right, sight.here, sight.width, image, plane)
    if planes[ch.OTHERS_NEXT] >= 0:
        plane = base + planes[ch.OTHERS_NEXT]
        image[plane] = 0.0
        for k in range(count):
            following = crew[others[k]].next_cell
            if following >= 0:
                ch.mark_cell(following, agent.cell, world.width, down, right, sight.here, sight.width, image, plane)
    if planes[ch.OTHERS_AT_GOAL] >= 0:
        ch.draw_others_at_goal(crew, spots, others, count, image, base + planes[ch.OTHERS_AT_GOAL])


@jit
def _write_features(
    sight: Sight,
    b: int,
    world: World,
    m: int,
    distances: Distances,
    state: State,
    agent: Array,
    i: int,
    values: Array,
    row: int,
) -> None:
    """Write the features of agent `i` of environment `b` to `row` of `values`."""
    at = sight.places
    up = agent.heading if sight.egocentric else _NORTH
    if at[ft.GOAL_VECTOR] >= 0:
        down, right = sight.steps[up, 0], sight.steps[up, 1]
        ft.write_goal_vector(world, agent, down, right, values, row, at[ft.GOAL_VECTOR])
    if at[ft.LOCATION] >= 0:
        ft.write_location(world, agent, values, row, at[ft.LOCATION])
    if at[ft.ACTION_ADVANTAGE] >= 0:
        slot, place = distances.slot[m, agent.goal], at[ft.ACTION_ADVANTAGE]
        ft.write_action_advantage(world, m, distances.to_go, slot, sight.cardinal, agent, values, row, place)
    if at[ft.LAST_ACTIONS] >= 0:
        num_actions = 5 if sight.cardinal else 4
        ft.write_last_actions(state.history, b, i, num_actions, values, row, at[ft.LAST_ACTIONS])
    if at[ft.TIME] >= 0:
        values[row, at[ft.TIME]] = state.time[b] / sight.max_steps


@jit
def _lay_view(height: int, width: int, cell: int, offsets: Array, up: int, cells: Array) -> None:
    """Write the map cell under each cell of the view; `C` outside the map."""
    row, col = divmod(cell, width)
    for j in range(cells.size):
        r, c = row + offsets[up, j, 0], col + offsets[up, j, 1]
        cells[j] = r * width + c if 0 <= r < height and 0 <= c < width else height * width


@jit
def _find_others(cells: Array, seen: Array, occupant: Array, b: int, i: int, spots: Array, others: Array) -> int:
    """List the other agents in view; return how many there are."""
    count = 0
    for j in range(cells.size):
        other = occupant[b, cells[j]]
        if other >= 0 and other != i and seen[j]:
            spots[count] = j
            others[count] = other
            count += 1
    return count


@jit
def _look(here: int, width: int, obstacle: Array, m: int, cells: Array, seen: Array) -> None:
    """Tell which cells are seen: those with no obstacle strictly between on the straight (Bresenham) line to them."""
    row, col = divmod(here, width)
    for j in range(cells.size):
        down, right = j // width - row, j % width - col
        length = max(abs(down), abs(right))
        seen[j] = True
        for k in range(1, length):
            r = row + np.sign(down) * ((2 * k * abs(down) + length) // (2 * length))
            c = col + np.sign(right) * ((2 * k * abs(right) + length) // (2 * length))
            if obstacle[m, cells[r * width + c]] > 0:
                seen[j] = False
                break


@jit
def _write_mask(leads_to: Array, m: int, cardinal: bool, agent: Array, mask: Array, row: int) -> None:
    """Allow waiting, and to agents that are active turning and every move that no obstacle blocks."""
    wait = _CARDINAL_WAIT if cardinal else _WAIT
    for action in range(mask.shape[1]):
        towards = direction(cardinal, agent.heading, action)
        if towards == NO_MOVE:
            mask[row, action] = agent.active or action == wait
        else:
            mask[row, action] = agent.active and leads_to[m, towards, agent.cell] != agent.cell


observe = jit(_observe)
observe_in_parallel = parallel_jit(_observe)
