"""The channels of the image: each declares its planes, its bounds and what draws them.

A kernel draws one channel for all agents: `image` (B, N, K, V) float32, `V = h * w` cells of the view, from plane
number `plane` on. What the other arrays hold is said in `core/scene.py` and `core/state.py`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numba import prange

from mapf_pz.core.jit import BatchKernel, jit
from mapf_pz.core.scene import Scene, find_next_cells
from mapf_pz.core.state import Array
from mapf_pz.core.world import STEPS


@BatchKernel
def _draw_view(
    obstacle: Array, maps: Array, cells: Array, seen: Array, count: Array, spots: Array, image: Array, plane: int
) -> None:
    for b in prange(cells.shape[0]):
        for i in range(cells.shape[1]):
            for j in range(cells.shape[2]):
                image[b, i, plane, j] = obstacle[maps[b], cells[b, i, j]] if seen[b, i, j] else -1.0
            for k in range(count[b, i]):
                image[b, i, plane, spots[b, i, k]] = 0.5


def draw_view(scene: Scene, image: Array, plane: int) -> None:
    """0 free, 0.5 another agent, 1 obstacle or outside, -1 unseen."""
    views = scene.views
    maps, obstacle = scene.state.map, scene.world.obstacle
    _draw_view(scene.num_threads, obstacle, maps, views.cells, views.seen, views.count, views.spots, image, plane)


@BatchKernel
def _draw_goal(agents: Array, cells: Array, image: Array, plane: int) -> None:
    for b in prange(cells.shape[0]):
        for i in range(cells.shape[1]):
            goal = agents[b, i].goal
            for j in range(cells.shape[2]):
                image[b, i, plane, j] = 1.0 if cells[b, i, j] == goal else 0.0


def draw_goal(scene: Scene, image: Array, plane: int) -> None:
    """1 on the agent's own goal."""
    _draw_goal(scene.num_threads, scene.state.agents, scene.views.cells, image, plane)


@BatchKernel
def _draw_orientation(
    agents: Array, first: Array, here: int, count: Array, spots: Array, others: Array, image: Array, plane: int
) -> None:
    for b in prange(agents.shape[0]):
        for i in range(agents.shape[1]):
            _clear(image, b, i, plane)
            image[b, i, plane, here] = (1 + (agents[b, i].heading - first[b, i]) % 4) / 4
            for k in range(count[b, i]):
                heading = agents[b, others[b, i, k]].heading
                image[b, i, plane, spots[b, i, k]] = (1 + (heading - first[b, i]) % 4) / 4


def draw_orientation(scene: Scene, image: Array, plane: int) -> None:
    """On each agent in view, the observer among them, `(1 + k) / 4` with `k` its heading."""
    views, here = scene.views, scene.sight.here
    agents, threads = scene.state.agents, scene.num_threads
    _draw_orientation(threads, agents, views.first, here, views.count, views.spots, views.others, image, plane)


@BatchKernel
def _draw_edge_weights(edge: Array, maps: Array, first: Array, cells: Array, image: Array, plane: int) -> None:
    for b in prange(cells.shape[0]):
        for i in range(cells.shape[1]):
            for k in range(4):
                towards = (first[b, i] + k) % 4
                for j in range(cells.shape[2]):
                    image[b, i, plane + k, j] = edge[maps[b], towards, cells[b, i, j]]


def draw_edge_weights(scene: Scene, image: Array, plane: int) -> None:
    """Weight of leaving each cell in four directions over the largest; blocked -1, outside 0."""
    edge, maps, views = scene.world.edge, scene.state.map, scene.views
    _draw_edge_weights(scene.num_threads, edge, maps, views.first, views.cells, image, plane)


@BatchKernel
def _draw_cost_to_go(
    slot: Array,
    to_go: Array,
    nearest: Array,
    scale: Array,
    maps: Array,
    agents: Array,
    cells: Array,
    image: Array,
    plane: int,
) -> None:
    for b in prange(cells.shape[0]):
        for i in range(cells.shape[1]):
            agent = agents[b, i]
            table = slot[maps[b], agent.goal]
            own = to_go[table, agent.cell, agent.heading % to_go.shape[2]]
            for j in range(cells.shape[2]):
                nearer = (own - nearest[table, cells[b, i, j]]) / scale[maps[b]]
                image[b, i, plane, j] = min(max(nearer, -1.0), 1.0) if own < np.inf else -1.0


def draw_cost_to_go(scene: Scene, image: Array, plane: int) -> None:
    """How much nearer to the goal each cell is: `clip((D_own - D) / ((h + w) * mean weight), -1, 1)`.

    `D` is the least cost to go over headings, `D_own` the observer's own; -1 where there is no path.
    """
    slot, to_go, nearest = scene.distances
    scale = (scene.sight.height + scene.sight.width) * scene.world.mean_weight
    maps, agents, cells = scene.state.map, scene.state.agents, scene.views.cells
    _draw_cost_to_go(scene.num_threads, slot, to_go, nearest, scale, maps, agents, cells, image, plane)


@BatchKernel
def _draw_heuristic(
    slot: Array,
    nearest: Array,
    leads_to: Array,
    maps: Array,
    agents: Array,
    first: Array,
    cells: Array,
    image: Array,
    plane: int,
) -> None:
    for b in prange(cells.shape[0]):
        m = maps[b]
        for i in range(cells.shape[1]):
            table = slot[m, agents[b, i].goal]
            for k in range(4):
                towards = (first[b, i] + k) % 4
                for j in range(cells.shape[2]):
                    here = cells[b, i, j]
                    nearer = nearest[table, leads_to[m, towards, here]] < nearest[table, here]
                    image[b, i, plane + k, j] = 1.0 if nearer else 0.0


def draw_heuristic(scene: Scene, image: Array, plane: int) -> None:
    """1 where leaving the cell in that direction leads nearer to the goal (the channels of DHC, Ma et al., 2021)."""
    slot, _, nearest = scene.distances
    state, views = scene.state, scene.views
    leads_to, threads = scene.world.leads_to, scene.num_threads
    _draw_heuristic(threads, slot, nearest, leads_to, state.map, state.agents, views.first, views.cells, image, plane)


@BatchKernel
def _mark_others(
    agents: Array,
    field: int,
    map_width: int,
    here: int,
    width: int,
    up: Array,
    count: Array,
    others: Array,
    image: Array,
    plane: int,
) -> None:
    """Set to 1 where the other agents' goals (`field` 0) or next cells (1) lie in view."""
    for b in prange(agents.shape[0]):
        for i in range(agents.shape[1]):
            _clear(image, b, i, plane)
            row, col = divmod(agents[b, i].cell, map_width)
            down, right = STEPS[up[b, i]]
            for k in range(count[b, i]):
                other = agents[b, others[b, i, k]]
                marked = other.goal if field == 0 else other.next_cell
                if marked >= 0:
                    rows, cols = marked // map_width - row, marked % map_width - col
                    r = here // width - (rows * down + cols * right)
                    c = here % width + (rows * right - cols * down)
                    if 0 <= r < image.shape[3] // width and 0 <= c < width:
                        image[b, i, plane, r * width + c] = 1.0


def draw_other_goals(scene: Scene, image: Array, plane: int) -> None:
    """1 on goals of the other agents in view."""
    _mark(scene, 0, image, plane)


def draw_others_next(scene: Scene, image: Array, plane: int) -> None:
    """1 on cells that the other agents in view would enter next along their own cheapest paths."""
    find_next_cells(scene)
    _mark(scene, 1, image, plane)


def _mark(scene: Scene, field: int, image: Array, plane: int) -> None:
    sight, views, agents, threads = scene.sight, scene.views, scene.state.agents, scene.num_threads
    width = scene.world.width
    _mark_others(
        threads, agents, field, width, sight.here, sight.width, views.up, views.count, views.others, image, plane
    )


@BatchKernel
def _draw_others_at_goal(agents: Array, count: Array, spots: Array, others: Array, image: Array, plane: int) -> None:
    for b in prange(agents.shape[0]):
        for i in range(agents.shape[1]):
            _clear(image, b, i, plane)
            for k in range(count[b, i]):
                other = agents[b, others[b, i, k]]
                image[b, i, plane, spots[b, i, k]] = 1.0 if other.cell == other.goal else -1.0


def draw_others_at_goal(scene: Scene, image: Array, plane: int) -> None:
    """On each other agent in view 1 if it is on its goal, else -1."""
    views, agents = scene.views, scene.state.agents
    _draw_others_at_goal(scene.num_threads, agents, views.count, views.spots, views.others, image, plane)


@jit
def _clear(image: Array, b: int, i: int, plane: int) -> None:
    for j in range(image.shape[3]):
        image[b, i, plane, j] = 0.0


@dataclass(frozen=True)
class Channel:
    """What one channel adds to the image."""

    draw: Callable[[Scene, Array, int], None]
    planes: int = 1
    low: float = 0
    high: float = 1
    needs_distances: bool = False


CHANNELS: dict[str, Channel] = {
    "view": Channel(draw_view, low=-1),
    "goal": Channel(draw_goal),
    "orientation": Channel(draw_orientation),
    "edge_weights": Channel(draw_edge_weights, planes=4, low=-1),
    "cost_to_go": Channel(draw_cost_to_go, low=-1, needs_distances=True),
    "heuristic": Channel(draw_heuristic, planes=4, needs_distances=True),
    "other_goals": Channel(draw_other_goals),
    "others_next": Channel(draw_others_next, needs_distances=True),
    "others_at_goal": Channel(draw_others_at_goal, low=-1),
}
