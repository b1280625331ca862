"""The cost to go around agents that are at their goals, whose cells count as obstacles.

Each agent has a separate table: a copy of its goal's table in which these cells are closed. That changes only states
all of whose cheapest paths lead through a closed cell. These are found first; then Dijkstra's algorithm computes their
costs from those of the others (Ramalingam and Reps, 1996, An Incremental Algorithm for a Generalization of the
Shortest-Path Problem).
"""

from __future__ import annotations

import numpy as np
from numba import prange

from mapf_pz._internal.jit import Array, BatchKernel, jit
from mapf_pz.simulator.kernels.cost_lookup import cost_at
from mapf_pz.simulator.kernels.cost_tables import CostTables
from mapf_pz.simulator.kernels.cost_to_go import lower, settle
from mapf_pz.simulator.kernels.state import WAIT_WEIGHT, CostToGo, Distances, State, World

_UNKNOWN = -2
_NOT_AT_GOAL = -1
_ROUNDING = np.float32(1 + 1e-6)
"""Costs that differ by less are equal: those of equal edge weights are products, and others are sums."""


class CostAround:
    """The agents' own tables, computed again when other agents are at their goals than before."""

    def __init__(self, world: World, tables: CostTables, state: State, num_threads: int) -> None:
        """Keep references to the arrays; the last B * N of the tables are the agents' own."""
        num_envs, num_agents = state.agents.shape
        num_tables, cells, num_headings = tables.arrays.exact.shape
        self._work = (world, tables.arrays, num_tables - num_envs * num_agents, state.map, state.agents)
        self._num_threads = num_threads
        self._at_goal = np.empty((num_envs, num_agents), np.int32)
        self._scratch = np.empty((num_threads, 3, cells * num_headings), np.int32)
        self._affected = np.zeros((num_threads, cells * num_headings), np.bool_)

    def reset(self, envs: list[int]) -> None:
        """Forget the tables of the environments `envs`, which have new episodes."""
        self._at_goal[envs] = _UNKNOWN

    def update(self) -> None:
        """Set every agent's table to the cost to go around the other agents that are at their goals.

        An agent that has no path around them keeps the table of its goal.
        """
        _update_tables(self._num_threads, *self._work, self._at_goal, self._scratch, self._affected)


@BatchKernel
def _update_tables(
    world: World, distances: Distances, first: int, maps: Array, all_agents: Array, at_goal: Array, scratch: Array,
    affected: Array
) -> None:  # fmt: skip
    chunks = scratch.shape[0]
    for chunk in prange(chunks):
        for b in range(chunk, maps.size, chunks):
            if _note_agents_at_goals(all_agents[b], at_goal[b]):
                own = first + b * all_agents.shape[1]
                _update(world, maps[b], distances, own, all_agents[b], at_goal[b], scratch[chunk], affected[chunk])


@jit
def _note_agents_at_goals(agents: Array, at_goal: Array) -> bool:
    """Write the cell of each agent at its goal to `at_goal` (N,), otherwise -1; return whether anything has changed."""
    changed = False
    for i in range(agents.size):
        cell = agents[i].cell if agents[i].cell == agents[i].goal else _NOT_AT_GOAL
        changed |= at_goal[i] != cell
        at_goal[i] = cell
    return changed


@jit
def _update(
    world: World, m: int, distances: Distances, first: int, agents: Array, at_goal: Array, scratch: Array,
    affected: Array
) -> None:  # fmt: skip
    """Set the tables of the agents of an environment; `first` is the agents' first own table."""
    to_go = CostToGo(distances.packed, distances.exact, distances.least)
    for i in range(agents.size):
        agent, own = agents[i], first + i
        agent.table = distances.slot[m, agent.goal]
        distances.exact[own] = distances.exact[agent.table]
        distances.least[own] = distances.least[agent.table]
        if _close(world, m, agent.goal, at_goal, distances.exact[own], distances.least[own], scratch, affected) and (
            cost_at(to_go, own, agent.cell, agent.heading) < np.inf
        ):
            agent.table = own


@jit
def _close(
    world: World, m: int, goal: int, cells: Array, exact: Array, least: Array, scratch: Array, affected: Array
) -> bool:
    """Close `cells`, except the goal and -1, in a table: `exact` (C + 1, D), `least` (C + 1,); False: there is none.

    `scratch` (3, (C + 1) * D) int32; `affected` ((C + 1) * D,) bool is False before and after.
    """
    headings, cost = exact.shape[1], exact.reshape(-1)
    queue, heap, place = scratch[0], scratch[1], scratch[2]
    closed = 0
    for cell in cells:
        if cell >= 0 and cell != goal:
            for heading in range(headings):
                queue[closed] = cell * headings + heading
                affected[queue[closed]] = True
                closed += 1
    if closed == 0:
        return False
    count = _find_affected(world, m, headings, cost, queue, closed, affected)
    # A closed state is -inf for now, so that nothing lowers it and no path leads through it.
    for k in range(count):
        cost[queue[k]] = -np.inf if k < closed else np.inf
    place[: cost.size] = -1
    size = 0
    for state in queue[closed:count]:
        size = lower(cost, heap, place, size, state, _cheapest(world, m, headings, cost, affected, state))
    settle(world, m, cost, headings, heap, place, size)
    for state in queue[:closed]:
        cost[state] = np.inf
    for state in queue[:count]:
        affected[state] = False
        least[state // headings] = exact[state // headings].min()
    return True


@jit
def _find_affected(world: World, m: int, headings: int, cost: Array, queue: Array, closed: int, affected: Array) -> int:
    """Append to the `closed` states in `queue` those whose cost rises, mark them as affected, and count all of them.

    A state is affected once all states that come next on its cheapest paths are.
    """
    head, tail = 0, closed
    while head < tail:
        cell, heading = queue[head] // headings, queue[head] % headings
        head += 1
        for k in range(4 if headings == 1 else 3):
            # The states that lead to this one: by a move, or by a turn (`k` 1 and 2).
            if headings == 1 or k == 0:
                before = world.leads_to[m, (k + 2) % 4 if headings == 1 else heading ^ 2, cell] * headings + heading
            else:
                before = cell * headings + (heading + 2 * k - 3) % 4
            if affected[before] or cost[before] == 0 or cost[before] == np.inf:
                continue
            if _cheapest(world, m, headings, cost, affected, before) > cost[before] * _ROUNDING:
                affected[before] = True
                queue[tail] = before
                tail += 1
    return tail


@jit
def _cheapest(world: World, m: int, headings: int, cost: Array, affected: Array, state: int) -> float:
    """Return the least cost of a state by the costs of the states that it leads to and that are not affected."""
    cell, heading = state // headings, state % headings
    least = np.inf
    for k in range(4 if headings == 1 else 3):
        if headings == 1 or k == 0:
            towards = k if headings == 1 else heading
            after = world.leads_to[m, towards, cell] * headings + heading
            price = world.weight[m, towards, cell]
        else:
            after = cell * headings + (heading + 2 * k - 3) % 4
            price = world.weight[m, WAIT_WEIGHT, cell]
        if not affected[after]:
            least = min(least, price + cost[after])
    return least
