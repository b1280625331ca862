"""The scene: what all views lie on. Which map cell is under each cell of a view, and which agents are in it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import prange

from mapf_pz.core.jit import BatchKernel, jit
from mapf_pz.core.path import next_cell
from mapf_pz.core.state import Array, Distances, State, World
from mapf_pz.types import Heading

_EAST, _NORTH = int(Heading.EAST), int(Heading.NORTH)


class Sight(NamedTuple):
    """The geometry of a view of `V = h * w` cells."""

    height: int
    width: int
    here: int  # the observer's own place in the view
    egocentric: bool
    see_through_walls: bool
    offsets: Array  # (4, V, 2) int32: (row, col) from the observer, for each direction that is up in the view


class Views(NamedTuple):
    """All agents' views, laid over the map: scratch, filled anew for each observation."""

    cells: Array  # (B, N, V) uint32: the map cell under each cell of the view; the number C outside the map
    seen: Array  # (B, N, V) bool: False where an obstacle hides the cell
    count: Array  # (B, N) int32: how many other agents are in view
    spots: Array  # (B, N, V) uint32: their places in the view, the first `count` of them
    others: Array  # (B, N, V) uint32: their indices
    up: Array  # (B, N) int32: the direction that is up in the view: the observer's heading, or north
    first: Array  # (B, N) int32: the direction of the first of four planes: the observer's heading, or east


class Scene(NamedTuple):
    """Everything that can be observed."""

    num_threads: int
    sight: Sight
    views: Views
    world: World
    distances: Distances
    state: State
    cardinal: bool
    max_steps: int


def allocate_views(num_envs: int, num_agents: int, num_cells: int) -> Views:
    """Make room for the views of B x N agents, V cells each."""
    each, cells = (num_envs, num_agents), (num_envs, num_agents, num_cells)
    return Views(
        cells=np.zeros(cells, np.uint32),
        seen=np.ones(cells, np.bool_),
        count=np.zeros(each, np.int32),
        spots=np.zeros(cells, np.uint32),
        others=np.zeros(cells, np.uint32),
        up=np.zeros(each, np.int32),
        first=np.zeros(each, np.int32),
    )


def lay_views(scene: Scene) -> None:
    """Fill `scene.views` for the present state."""
    threads, sight, views, world, state = scene.num_threads, scene.sight, scene.views, scene.world, scene.state
    _lay_views(threads, sight, world.height, world.width, state.agents, views.cells, views.up, views.first)
    if not sight.see_through_walls:
        _look(threads, sight.here, sight.width, world.obstacle, state.map, views.cells, views.seen)
    _find_others(threads, state.occupant, views.cells, views.seen, views.count, views.spots, views.others)


def find_next_cells(scene: Scene) -> None:
    """Set every agent's next cell on its own cheapest path."""
    world, state = scene.world, scene.state
    slot, to_go, _ = scene.distances
    _find_next_cells(scene.num_threads, world.leads_to, world.weight, slot, to_go, state.map, state.agents)


@BatchKernel
def _lay_views(sight: Sight, height: int, width: int, agents: Array, cells: Array, up: Array, first: Array) -> None:
    for b in prange(agents.shape[0]):
        for i in range(agents.shape[1]):
            heading = agents[b, i].heading
            up[b, i] = heading if sight.egocentric else _NORTH
            first[b, i] = heading if sight.egocentric else _EAST
            row, col = divmod(agents[b, i].cell, width)
            for j in range(cells.shape[2]):
                r, c = row + sight.offsets[up[b, i], j, 0], col + sight.offsets[up[b, i], j, 1]
                inside = 0 <= r < height and 0 <= c < width
                cells[b, i, j] = r * width + c if inside else height * width


@BatchKernel
def _find_others(occupant: Array, cells: Array, seen: Array, count: Array, spots: Array, others: Array) -> None:
    for b in prange(cells.shape[0]):
        for i in range(cells.shape[1]):
            found = 0
            for j in range(cells.shape[2]):
                other = occupant[b, cells[b, i, j]]
                if other >= 0 and other != i and seen[b, i, j]:
                    spots[b, i, found] = j
                    others[b, i, found] = other
                    found += 1
            count[b, i] = found


@BatchKernel
def _look(here: int, width: int, obstacle: Array, maps: Array, cells: Array, seen: Array) -> None:
    """Tell which cells are seen: those with no obstacle strictly between on the straight (Bresenham) line to them."""
    row, col = divmod(here, width)
    for b in prange(cells.shape[0]):
        for i in range(cells.shape[1]):
            for j in range(cells.shape[2]):
                down, right = j // width - row, j % width - col
                length = max(abs(down), abs(right))
                seen[b, i, j] = True
                for k in range(1, length):
                    r, c = row + _between(down, k, length), col + _between(right, k, length)
                    if obstacle[maps[b], cells[b, i, r * width + c]] > 0:
                        seen[b, i, j] = False


@jit
def _between(offset: int, k: int, length: int) -> int:
    """Return step `k` of `length` towards `offset`, rounded to a whole cell, halves away from the observer."""
    return np.sign(offset) * ((2 * k * abs(offset) + length) // (2 * length))


@BatchKernel
def _find_next_cells(leads_to: Array, weight: Array, slot: Array, to_go: Array, maps: Array, agents: Array) -> None:
    for b in prange(maps.size):
        ways, costs = leads_to[maps[b]], weight[maps[b]]
        for i in range(agents.shape[1]):
            agent = agents[b, i]
            table = to_go[slot[maps[b], agent.goal]]
            agent.next_cell = next_cell(ways, costs, table, agent.cell, agent.heading)
