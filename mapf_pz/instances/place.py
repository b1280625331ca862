"""Starts and goals of agents, drawn where all of them can reach each other."""

from __future__ import annotations

import numpy as np

from mapf_pz._internal.arrays import Bools, Ints
from mapf_pz._internal.jit import Array, jit
from mapf_pz.instances.instance import Grid, Instance, Scenario


def components(free: Bools) -> Ints:
    """Number the 4-connected components of a map `free` (H, W): (H, W) int32, -1 on obstacles."""
    padded = np.zeros((free.shape[0] + 2, free.shape[1] + 2), np.bool_)  # np.pad does this ten times slower
    padded[1:-1, 1:-1] = free
    labels = np.full(padded.shape, -1, np.int32)
    _label(padded.ravel(), padded.shape[1], labels.ravel(), np.empty(padded.size, np.int32))
    return labels[1:-1, 1:-1]


def check_reachable(instance: Instance) -> None:
    """Raise `ValueError` naming the first agent that has a goal which no path leads to."""
    labels = components(instance.grid.free)
    starts, goals = instance.scenario.starts, instance.scenario.goals.reshape(len(instance.scenario), -1, 2)
    apart = labels[goals[..., 0], goals[..., 1]] != labels[starts[:, 0], starts[:, 1]][:, None]
    if apart.any():
        agent, k = np.argwhere(apart)[0].tolist()
        (row, col), (goal_row, goal_col) = starts[agent].tolist(), goals[agent, k].tolist()
        raise ValueError(
            f"agent {agent}: no path on map {instance.grid.name!r} leads from its start [row {row}, col {col}] "
            f"to its goal [row {goal_row}, col {goal_col}]"
        )


def largest_component(free: Bools) -> Ints:
    """Return the cells of the largest component of a map `free` (H, W): (C, 2) int32, [row, col], in reading order."""
    labels = components(free).ravel()
    sizes = np.bincount(labels + 1, minlength=2)[1:]
    cells = np.flatnonzero(labels == sizes.argmax())
    return np.stack(np.divmod(cells, free.shape[1]), axis=1).astype(np.int32)


def place(grid: Grid, num_agents: int, rng: np.random.Generator, goals_per_agent: int = 1) -> Scenario:
    """Draw starts and goals in the map's largest component, as `place_on` does."""
    return place_on(largest_component(grid.free), num_agents, rng, goals_per_agent)


def place_on(cells: Ints, num_agents: int, rng: np.random.Generator, goals_per_agent: int = 1) -> Scenario:
    """Draw different starts, and goals, among `cells` (C, 2); no agent starts on its goal, unless `C` is 1.

    With one goal per agent, the goals of all agents differ: goals (N, 2). With more, an agent's goals differ from the
    one before, and the last from the first as they are gone through again: goals (N, L, 2). (Of two cells, an odd
    number of goals must repeat one.)

    Raises:
        ValueError: There are fewer cells than agents, or a number is less than 1.
    """
    if num_agents < 1 or goals_per_agent < 1:
        raise ValueError(f"num_agents={num_agents}, goals_per_agent={goals_per_agent}: expected 1 or more")
    if num_agents > len(cells):
        raise ValueError(f"{num_agents} agents do not fit on the {len(cells)} cells of the map's largest component")
    starts = rng.choice(len(cells), num_agents, replace=False)
    if goals_per_agent == 1:
        goals = _goals(starts, len(cells), rng)
    else:
        goals = _goal_sequences(starts, len(cells), goals_per_agent, rng)
    return Scenario(cells[starts], cells[goals])


def _goals(starts: Ints, size: int, rng: np.random.Generator) -> Ints:
    """Draw different goals (N,) below `size`, each other than its start."""
    # Even with an agent on every cell, at least a third of all draws are good.
    while True:
        goals = rng.choice(size, len(starts), replace=False)
        if size == 1 or (goals != starts).all():
            return goals


def _goal_sequences(starts: Ints, size: int, length: int, rng: np.random.Generator) -> Ints:
    """Draw goals (N, L) below `size`, each other than the one before, the first other than the start."""
    hops = rng.integers(1, max(size, 2), (len(starts), length))
    goals = (starts[:, None] + hops.cumsum(axis=1)) % size
    if min(length, size) > 2:
        goals[:, -1] = _other_than(goals[:, -2], goals[:, 0], size, rng)
    return goals


def _other_than(first: Ints, second: Ints, size: int, rng: np.random.Generator) -> Ints:
    """Draw numbers (N,) below `size` that are neither `first` nor `second` (N,)."""
    low, high = np.minimum(first, second), np.maximum(first, second)
    drawn = rng.integers(size - 1 - (low < high))
    drawn += drawn >= low
    return drawn + ((drawn >= high) & (low < high))


@jit
def _label(free: Array, width: int, labels: Array, queue: Array) -> None:
    """Fill `labels` (C,) int32, -1 before. The map `free` (C,) has a blocked border; `queue` (C,) int32 is scratch."""
    label = 0
    for first in range(free.size):
        if not free[first] or labels[first] >= 0:
            continue
        labels[first] = label
        queue[0] = first
        head, tail = 0, 1
        while head < tail:
            cell = queue[head]
            head += 1
            for step in (1, width, -1, -width):
                to = cell + step
                if free[to] and labels[to] < 0:
                    labels[to] = label
                    queue[tail] = to
                    tail += 1
        label += 1
