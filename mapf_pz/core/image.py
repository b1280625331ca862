"""The image: lay each agent's view over the map, find the other agents in it, then draw channel after channel."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import prange

from mapf_pz.core import channels as ch
from mapf_pz.core.jit import jit, parallel_jit
from mapf_pz.core.path import find_next_cells
from mapf_pz.core.state import Array, Distances, State, World
from mapf_pz.types import Heading

_EAST, _NORTH = int(Heading.EAST), int(Heading.NORTH)


class Sight(NamedTuple):
    """The view's geometry, and the scratch of B environments. `V = h * w` cells of the view."""

    height: int
    width: int
    here: int  # the observer's own place in the view
    egocentric: bool
    see_through_walls: bool
    offsets: Array  # (4, V, 2) int32: (row, col) from the observer, for each direction that is up in the view
    planes: Array  # (number of channels,) int32: the channel's first plane; -1: not observed
    cells: Array  # (B, V) uint32: scratch: the map cell under each cell of the view
    seen: Array  # (B, V) bool: scratch; stays True where one sees through walls
    others: Array  # (B, 2, V) uint32: scratch: places and indices of the other agents in view


def _draw_images(sight: Sight, world: World, distances: Distances, state: State, image: Array) -> None:
    """Draw what all agents see to `image` (B * N * K, V) float32; agents that have disappeared see zeros."""
    for b in prange(state.time.size):
        m, crew = state.map[b], state.agents[b]
        if sight.planes[ch.OTHERS_NEXT] >= 0:
            find_next_cells(world, m, distances, crew)
        _draw_crew(sight, world, m, distances, b, crew, state.occupant[b], image)


@jit
def _draw_crew(
    sight: Sight, world: World, m: int, distances: Distances, b: int, crew: Array, occupant: Array, image: Array
) -> None:
    """Draw what the crew of environment `b` sees on map `m`."""
    cells, seen, spots, others, at = sight.cells[b], sight.seen[b], sight.others[b, 0], sight.others[b, 1], sight.planes
    num_planes = image.shape[0] // (sight.cells.shape[0] * crew.size)
    for i in range(crew.size):
        agent = crew[i]
        plane = (b * crew.size + i) * num_planes
        if not agent.was_active:
            image[plane : plane + num_planes] = 0.0
            continue
        up = agent.heading if sight.egocentric else _NORTH
        first = agent.heading if sight.egocentric else _EAST
        slot = distances.slot[m, agent.goal]
        _lay_view(world.height, world.width, agent.cell, sight.offsets, up, cells)
        if not sight.see_through_walls:
            _look(sight.here, sight.width, world.obstacle, m, cells, seen)
        count = _find_others(cells, seen, occupant, i, spots, others)

        if at[ch.VIEW] >= 0:
            ch.draw_view(world.obstacle, m, cells, seen, spots, count, image, plane + at[ch.VIEW])
        if at[ch.GOAL] >= 0:
            ch.draw_goal(agent.goal, cells, image, plane + at[ch.GOAL])
        if at[ch.ORIENTATION] >= 0:
            ch.draw_orientation(crew, i, first, sight.here, spots, others, count, image, plane + at[ch.ORIENTATION])
        if at[ch.EDGE_WEIGHTS] >= 0:
            ch.draw_edge_weights(world.edge, m, first, cells, image, plane + at[ch.EDGE_WEIGHTS])
        if at[ch.COST_TO_GO] >= 0:
            own = distances.to_go[slot, agent.cell, agent.heading % distances.to_go.shape[2]]
            scale = (sight.height + sight.width) * world.mean_weight[m]
            ch.draw_cost_to_go(distances.nearest, slot, own, scale, cells, image, plane + at[ch.COST_TO_GO])
        if at[ch.HEURISTIC] >= 0:
            ch.draw_heuristic(distances.nearest, slot, world.leads_to, m, first, cells, image, plane + at[ch.HEURISTIC])
        if at[ch.OTHER_GOALS] >= 0:
            ch.clear(image, plane + at[ch.OTHER_GOALS])
            for k in range(count):
                goal, where = crew[others[k]].goal, plane + at[ch.OTHER_GOALS]
                ch.mark_cell(goal, agent.cell, world.width, up, sight.here, sight.width, image, where)
        if at[ch.OTHERS_NEXT] >= 0:
            ch.clear(image, plane + at[ch.OTHERS_NEXT])
            for k in range(count):
                cell, where = crew[others[k]].next_cell, plane + at[ch.OTHERS_NEXT]
                if cell >= 0:
                    ch.mark_cell(cell, agent.cell, world.width, up, sight.here, sight.width, image, where)
        if at[ch.OTHERS_AT_GOAL] >= 0:
            ch.draw_others_at_goal(crew, spots, others, count, image, plane + at[ch.OTHERS_AT_GOAL])


@jit
def _lay_view(height: int, width: int, cell: int, offsets: Array, up: int, cells: Array) -> None:
    """Write the map cell under each cell of the view; `C` outside the map."""
    row, col = divmod(cell, width)
    for j in range(cells.size):
        r, c = row + offsets[up, j, 0], col + offsets[up, j, 1]
        cells[j] = r * width + c if 0 <= r < height and 0 <= c < width else height * width


@jit
def _find_others(cells: Array, seen: Array, occupant: Array, i: int, spots: Array, others: Array) -> int:
    """List the other agents in view; return how many there are."""
    count = 0
    for j in range(cells.size):
        other = occupant[cells[j]]
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


draw_images = jit(_draw_images)
draw_images_in_parallel = parallel_jit(_draw_images)
