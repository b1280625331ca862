"""The order in which agents choose their cells.

If agents must stay at their goals, the time since an agent was at its goal comes first, then its cost to go at the
start. Otherwise there are three priorities: `NEAREST`, the lowest cost to go first; `ELAPSED`, the longest time since
the last goal first; and `LATE`, agents first that have been on their way for more than `LATE_FACTOR` times the cost to
go at its beginning, then the others, both the nearest first.
"""

from __future__ import annotations

import numpy as np

from mapf_pz._internal.jit import Array, jit
from mapf_pz.planners.copying import copy_row
from mapf_pz.planners.pibt.state import ELAPSED, LATE, PibtState, to_go
from mapf_pz.simulator.kernels.state import PlanningView

COST_BOUND = 2.0**24
"""Larger than any cost to go."""
LATE_FACTOR = 4
"""Number of steps per unit of the cost to go after which an agent is late."""
_RUN = 16  # length of the runs that are sorted by insertion


@jit
def prioritize(planning_view: PlanningView, passing: bool, priority: int, state: PibtState) -> None:
    """Sort the agents by priority. With `passing`, an agent only has to pass its goal; otherwise it must stay there."""
    agents, away, first_cost = planning_view.agents, state.away, state.first_cost
    for i in range(agents.size):
        cost, begins = to_go(planning_view, agents[i], agents[i].cell, agents[i].heading), away[i] < 0
        if passing:
            begins |= agents[i].arrived
        if begins:
            first_cost[i] = cost
        at_goal = begins if passing else agents[i].cell == agents[i].goal
        away[i] = 0 if at_goal else away[i] + 1
        if not passing:
            state.key[i] = priority_key(away[i], first_cost[i])
        elif priority == ELAPSED:
            state.key[i] = priority_key(away[i], cost)
        else:
            state.key[i] = priority_key(priority == LATE and away[i] > LATE_FACTOR * first_cost[i], cost)
    sort_by_key(state.key, state.order, state.merged)


@jit
def priority_key(away: int, cost: np.float32) -> float:
    """Return the sort key of an agent: by `away`, descending, then by `cost`, ascending."""
    return float(cost) - away * COST_BOUND


@jit
def sort_by_key(key: Array, order: Array, merged: Array) -> None:
    """Sort the agents `order` (N,) by `key` (N,), ascending, then by index.

    This is a merge sort that starts from the order of the previous step, in which many runs are sorted already;
    `merged` (N,) is scratch.
    """
    for start in range(0, order.size, _RUN):
        _insert(key, order, start, min(start + _RUN, order.size))
    width = _RUN
    while width < order.size:
        for start in range(0, order.size - width, 2 * width):
            _merge(key, order, merged, start, start + width, min(start + 2 * width, order.size))
        width *= 2


@jit
def _insert(key: Array, order: Array, start: int, end: int) -> None:
    for k in range(start + 1, end):
        i, position = order[k], k
        while position > start and _precedes(key, i, order[position - 1]):
            order[position] = order[position - 1]
            position -= 1
        order[position] = i


@jit
def _merge(key: Array, order: Array, merged: Array, start: int, middle: int, end: int) -> None:
    if not _precedes(key, order[middle], order[middle - 1]):
        return
    left, right, size = 0, middle, middle - start
    copy_row(order[start:middle], merged[:size])
    for position in range(start, end):
        if left == size:
            return
        if right < end and _precedes(key, order[right], merged[left]):
            order[position] = order[right]
            right += 1
        else:
            order[position] = merged[left]
            left += 1


@jit
def _precedes(key: Array, i: int, j: int) -> bool:
    return key[i] < key[j] or (key[i] == key[j] and i < j)
