"""Bounds that no plan can beat: agents that always move and never meet. For cardinal agents."""

from __future__ import annotations

import numpy as np

from mapf_pz.arrays import Ints
from mapf_pz.core.cost_to_go import shortest_steps
from mapf_pz.core.world import allocate, set_map
from mapf_pz.guidance import GuidanceGraph
from mapf_pz.instance import Grid, Instance


def shortest_lengths(grid: Grid, starts: Ints, goals: Ints) -> Ints:
    """Return the lengths (M,) int32 of the shortest paths from `starts` (M,) to `goals` (M,), which are cell numbers.

    A pair without a path has length -1.
    """
    world = allocate(1, grid.shape)
    set_map(world, 0, grid.free, GuidanceGraph.uniform(grid.free))
    cells = grid.free.size + 1
    by_goal = np.argsort(goals, kind="stable")
    lengths = np.empty(len(goals), np.int32)
    to_go, scratch = np.empty((cells, 1), np.float32), np.empty((2, cells), np.int32)
    headings = np.zeros(len(goals), np.int8)
    shortest_steps(world, 0, starts[by_goal], headings, goals[by_goal], to_go, scratch, lengths)
    return lengths[np.argsort(by_goal)]


def least_costs(instance: Instance) -> Ints:
    """Return the steps (N,) that each agent needs to its first goal when it is alone on the map."""
    return shortest_lengths(instance.grid, instance.start_cells, instance.goal_cells[:, 0])


def most_goals(instance: Instance, num_steps: int) -> Ints:
    """Return how many goals (N,) of its sequence each agent reaches in `num_steps` when it is alone on the map.

    An agent reaches at most its whole sequence: `exhausted_agents` is above 0 where that is too short.
    """
    goals = instance.goal_cells
    before = np.concatenate([instance.start_cells[:, None], goals[:, :-1]], axis=1)
    lengths = shortest_lengths(instance.grid, before.reshape(-1), goals.reshape(-1)).reshape(goals.shape)
    # A goal in the cell of the one before it takes a step, too: an agent reaches at most one goal per step.
    reached = np.maximum(lengths, 1).cumsum(axis=1) <= num_steps
    counts = instance.scenario.goal_counts
    if counts is not None:
        reached &= np.arange(goals.shape[1]) < counts[:, None]
    return reached.sum(axis=1)
