"""Bounds on the results of any plan, from the shortest paths of single agents. For cardinal agents."""

from __future__ import annotations

import numpy as np

from mapf_pz._internal.arrays import Ints
from mapf_pz.guidance import GuidanceGraph
from mapf_pz.instances.instance import Grid, Instance
from mapf_pz.simulator.kernels.path_length import shortest_lengths
from mapf_pz.simulator.kernels.world import allocate, set_map


def path_lengths(grid: Grid, starts: Ints, goals: Ints) -> Ints:
    """Return the lengths (M,) int32 of the shortest paths from `starts` (M,) to `goals` (M,), which are cell numbers.

    A pair without a path has length -1.
    """
    world = allocate(1, grid.shape)
    set_map(world, 0, grid.free, GuidanceGraph.uniform(grid.free))
    return shortest_lengths(world, 0, starts, np.zeros(len(goals), np.int8), goals, num_headings=1)


def least_costs(instance: Instance) -> Ints:
    """Return the cost (N,) of each agent to its first goal if it is alone on the map: an arrival takes a step."""
    return np.maximum(path_lengths(instance.grid, instance.start_cells, instance.goal_cells[:, 0]), 1)


def most_goals(instance: Instance, num_steps: int) -> Ints:
    """Return how many goals (N,) of its sequence each agent reaches in `num_steps` if it is alone on the map.

    An agent reaches at most its whole sequence: `exhausted_agents` is above 0 if the sequence is too short.
    """
    goals = instance.goal_cells
    before = np.concatenate([instance.start_cells[:, None], goals[:, :-1]], axis=1)
    lengths = path_lengths(instance.grid, before.reshape(-1), goals.reshape(-1)).reshape(goals.shape)
    # A goal on the same cell as the previous goal takes a step, too: an agent reaches at most one goal per step.
    reached = np.maximum(lengths, 1).cumsum(axis=1) <= num_steps
    counts = instance.scenario.goal_counts
    if counts is not None:
        reached &= np.arange(goals.shape[1]) < counts[:, None]
    return reached.sum(axis=1)
