"""Schedulers: they assign revealed tasks to agents in each step."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from mapf_pz._internal.arrays import Bools, Floats, Ints
from mapf_pz.planners.scheduling.pool import NONE, TaskPool


class Scheduler(Protocol):
    """Assigns a task to each agent."""

    def __call__(self, pool: TaskPool, costs: Floats, lengths: Floats) -> Ints:
        """Return the place in the pool of each agent's task, (N,) int64, all different.

        Tasks that were started must stay with their agents.

        Args:
            pool: The revealed tasks.
            costs: (N, K) float32: the cost to go of each agent to the next errand of each revealed task.
            lengths: (K,) float32: the length of the rest of each task, from its next errand to its last one.
        """
        ...


def keep(pool: TaskPool, costs: Floats, lengths: Floats) -> Ints:
    """Assign the nearest tasks to agents without one. Assignments are never changed."""
    return _assign(pool, costs, pool.owner != NONE)


def nearest(pool: TaskPool, costs: Floats, lengths: Floats) -> Ints:
    """Assign all tasks that were not started, again in each step, the nearest ones first."""
    return _assign(pool, costs, pool.started)


def shortest(pool: TaskPool, costs: Floats, lengths: Floats) -> Ints:
    """As `nearest`, with the length of the whole task added to that of the way to its first errand."""
    return _assign(pool, costs + lengths, pool.started)


def _assign(pool: TaskPool, costs: Floats, kept: Bools) -> Ints:
    """Return assignments that keep the tasks `kept` (K,): repeatedly the pair of an agent and a task of lowest cost."""
    places = np.full(len(costs), NONE)
    places[pool.owner[kept]] = np.flatnonzero(kept)
    agents, tasks = np.flatnonzero(places == NONE), np.flatnonzero(~kept)
    taken = np.zeros(len(tasks), np.bool_)
    order = np.argsort(costs[np.ix_(agents, tasks)], axis=None, kind="stable")
    for pair in order.tolist():
        agent, at = agents[pair // len(tasks)], pair % len(tasks)
        if places[agent] == NONE and not taken[at]:
            places[agent], taken[at] = tasks[at], True
    return places


SCHEDULERS: dict[str, Scheduler] = {"keep": keep, "nearest": nearest, "shortest": shortest}
"""The schedulers by name."""
