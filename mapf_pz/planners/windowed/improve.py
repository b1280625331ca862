"""Large neighborhood search over the paths within the window: replan a delayed agent, and the agents in its way.

A neighborhood starts with one agent. Its new path may collide with those of other agents, at a price. These agents join
the neighborhood and are replanned in turn. Their new paths may not collide with new paths, but may do so with the paths
of further agents, which join as well. The new paths are accepted if they lower the sum of costs. So chains of agents
that make way for each other are found, as in PIBT, but over many steps.

Jiang et al., *Scaling Lifelong Multi-Agent Path Finding to More Realistic Settings*, SoCS 2024, improve paths within a
window by large neighborhood search. Prices of collisions are from Arita and Okumura, *Lifelong LaCAM with Local
Guidance for Lifelong MAPF*, SoCS 2026.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapf_pz._internal.jit import Array, jit
from mapf_pz.planners.copying import copy_row
from mapf_pz.planners.pibt.state import NO_AGENT
from mapf_pz.planners.random import draw_below, seeded
from mapf_pz.planners.windowed.paths import Paths, colliding_agent, cost_of_path, occupy, release
from mapf_pz.planners.windowed.search import SearchScratch, find_path
from mapf_pz.simulator.kernels.state import PlanningView

MARGIN = 1e-3
"""The smallest change of the sum of costs that is not attributed to rounding."""
LARGEST = 24
"""Maximum number of agents in a neighborhood."""
PRICES = (0.5, 1.0, 2.0, 4.0)
"""Prices of collisions, in mean weights of the guidance graph; one is sampled for each neighborhood."""


class Neighborhood(NamedTuple):
    """At most K of N agents, their former paths over T steps, and the state of the random numbers."""

    agents: Array  # (K,) int32: the first `size` are in the neighborhood
    size: Array  # (1,) int64
    cell: Array  # (K, T + 1) int32: their former paths
    heading: Array  # (K, T + 1) int32
    cost: Array  # (K,) float32
    random: Array  # (1,) uint64


def allocate_neighborhood(window: int, seed: int) -> Neighborhood:
    """Allocate an empty neighborhood of agents with paths over `window` steps; `seed` must not be 0."""
    return Neighborhood(
        agents=np.zeros(LARGEST, np.int32),
        size=np.zeros(1, np.int64),
        cell=np.zeros((LARGEST, window + 1), np.int32),
        heading=np.zeros((LARGEST, window + 1), np.int32),
        cost=np.zeros(LARGEST, np.float32),
        random=seeded(seed),
    )


@jit
def improve(
    planning_view: PlanningView, passing: bool, mean_weight: float, attempts: int, paths: Paths,
    scratch: SearchScratch, neighborhood: Neighborhood
) -> None:  # fmt: skip
    """Choose a random agent `attempts` times, and if it is delayed, search for paths that lower the sum of costs."""
    random = neighborhood.random
    for _ in range(attempts):
        first = draw_below(random, planning_view.agents.size)
        if planning_view.agents[first].active and paths.cost[first] > paths.least[first] + MARGIN:
            price = mean_weight * PRICES[draw_below(random, len(PRICES))]
            _replan(planning_view, first, passing, price, paths, scratch, neighborhood)


@jit
def _replan(
    planning_view: PlanningView, first: int, passing: bool, price: float, paths: Paths, scratch: SearchScratch,
    neighborhood: Neighborhood
) -> None:  # fmt: skip
    """Replan agent `first`, and all agents that must make way; change nothing unless the sum of costs decreases."""
    neighborhood.size[0] = planned = 0
    _add(first, paths, neighborhood)
    former = float(paths.cost[first])
    bound = float(paths.least[first])  # of the new sum: costs of the new paths, and lower bounds of the others
    while planned < neighborhood.size[0] and bound < former - MARGIN:
        i, before = neighborhood.agents[planned], neighborhood.size[0]
        # A more expensive path could not lower the sum, even if all agents after this one had their best paths.
        limit = former - MARGIN - bound + paths.least[i]
        rotation = draw_below(neighborhood.random, 4)
        if not find_path(planning_view, i, passing, limit, price, rotation, paths, scratch):
            break
        if not _add_colliding(paths, scratch, neighborhood):
            break
        for k in range(before, neighborhood.size[0]):
            former += paths.cost[neighborhood.agents[k]]
            bound += paths.least[neighborhood.agents[k]]
        copy_row(scratch.cell, paths.cell[i])
        copy_row(scratch.heading, paths.heading[i])
        paths.cost[i] = cost_of_path(planning_view, i, passing, paths)
        # Later paths of this neighborhood must respect the new path. Otherwise two agents could make way for each other
        # forever.
        paths.fixed[i] = True
        occupy(paths, i)
        bound += paths.cost[i] - paths.least[i]
        planned += 1
    accepted = planned == neighborhood.size[0] and bound < former - MARGIN
    _finish(accepted, planned, paths, neighborhood)


@jit
def _add(i: int, paths: Paths, neighborhood: Neighborhood) -> None:
    """Add agent i to the neighborhood, and release its path."""
    k = neighborhood.size[0]
    neighborhood.agents[k], neighborhood.cost[k] = i, paths.cost[i]
    copy_row(paths.cell[i], neighborhood.cell[k])
    copy_row(paths.heading[i], neighborhood.heading[k])
    neighborhood.size[0] += 1
    release(paths, i)


@jit
def _add_colliding(paths: Paths, scratch: SearchScratch, neighborhood: Neighborhood) -> bool:
    """Add the agents whose paths collide with the path that was found; return whether there was room for them."""
    for t in range(1, scratch.cell.size):
        for swapping in (False, True):
            other = colliding_agent(paths.used, t, scratch.cell[t - 1], scratch.cell[t], swapping)
            if other != NO_AGENT:
                if neighborhood.size[0] == neighborhood.agents.size:
                    return False
                _add(other, paths, neighborhood)
    return True


@jit
def _finish(accepted: bool, planned: int, paths: Paths, neighborhood: Neighborhood) -> None:
    """Empty the neighborhood, the first agents of which have new paths; restore the former ones unless accepted."""
    for k in range(planned):
        # Agents that have joined, but have no new paths, were released by `_add`: only new paths must be removed here.
        paths.fixed[neighborhood.agents[k]] = False
        if not accepted:
            release(paths, neighborhood.agents[k])
    for k in range(0 if accepted else neighborhood.size[0]):
        i = neighborhood.agents[k]
        copy_row(neighborhood.cell[k], paths.cell[i])
        copy_row(neighborhood.heading[k], paths.heading[i])
        paths.cost[i] = neighborhood.cost[k]
        occupy(paths, i)
