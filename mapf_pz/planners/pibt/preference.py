"""The order in which an agent tries its choices: the four directions, and staying.

The cost of a choice comes first, then the number of agents that it hinders, then a random number. Hindrance is the idea
of *Lightweight and Effective Preference Construction in PIBT for Large-Scale Multi-Agent Pathfinding* (Okumura and
Nagai, SoCS 2025): of two cells that are equally near to its goal, an agent takes the one that fewer others need.
"""

from __future__ import annotations

import numpy as np

from mapf_pz._internal.jit import Array, jit
from mapf_pz.planners.pibt.state import NO_AGENT, STAY, UNDECIDED, PibtState, to_go
from mapf_pz.planners.random import draw
from mapf_pz.simulator.kernels.cost_lookup import num_headings
from mapf_pz.simulator.kernels.state import WAIT_WEIGHT, PlanningView

_HINDRANCE_SHIFT = 16  # the bits of a rank, from the highest: cost, hindrance, tie (12 bits), choice (3 bits)
_COMPARATORS = ((0, 1), (3, 4), (2, 4), (2, 3), (1, 4), (0, 3), (0, 2), (1, 3), (1, 2))  # a sorting network


@jit
def rank_choices(planning_view: PlanningView, hindrance: bool, state: PibtState) -> None:
    """Rank the choices of all agents in `state.want` that are undecided."""
    agents, rank, closer, demand = planning_view.agents, state.rank, state.closer, state.demand
    demand[:] = 0
    for i in range(agents.size):
        if state.want[i] == UNDECIDED:
            closer[i] = _rank(planning_view, agents[i], draw(state.random), demand, rank[i])
        else:
            closer[i] = 0 if state.choice[i] == STAY else 1 << state.choice[i]
    for i in range(agents.size):
        if state.want[i] == UNDECIDED:
            if hindrance:
                _add_hindrance(planning_view, i, closer, demand, rank[i])
            sort_ranks(rank[i])


@jit
def sort_ranks(rank: Array) -> None:
    """Sort an agent's ranks (5,), ascending."""
    for a, b in _COMPARATORS:
        rank[a], rank[b] = min(rank[a], rank[b]), max(rank[a], rank[b])


@jit
def _rank(planning_view: PlanningView, agent: Array, ties: int, demand: Array, rank: Array) -> int:
    """Rank an agent's choices by the cost to its goal, then by `ties`: 12 random bits per choice.

    Add the agent to the `demand` for the cells on which its cost to go decreases, and return their directions.
    """
    cell, rotates = agent.cell, num_headings(planning_view.to_go) == 4
    wait, own = planning_view.weight[WAIT_WEIGHT, cell], to_go(planning_view, agent, cell, agent.heading)
    closer = 0
    for direction in range(4):
        target = planning_view.leads_to[direction, cell]
        onward = to_go(planning_view, agent, target, direction)
        turns = (direction - agent.heading) & 3 if rotates else 0
        cost = planning_view.weight[direction, cell] + min(turns, 4 - turns) * wait
        rank[direction] = _pack(cost + onward, ties, direction)
        if onward < own and target != cell:
            closer |= 1 << direction
            demand[target] += 1
    rank[STAY] = _pack(np.float32(0.0) if cell == agent.goal else wait + own, ties, STAY)
    return closer


@jit
def _pack(cost: np.float32, ties: int, choice: int) -> int:
    """Pack a choice into one integer that sorts by cost: the bits of non-negative floats sort as the floats do."""
    tie = np.int64(ties >> np.uint64(12 * choice)) & 0xFFF
    return int((np.int64(np.float32(cost).view(np.int32)) << 32) | (tie << 3) | choice)


@jit
def _add_hindrance(planning_view: PlanningView, i: int, closer: Array, demand: Array, rank: Array) -> None:
    """Add to agent i's ranks how many agents each choice hinders.

    These are the agents that get closer to their goals on the chosen cell, from any adjacent cell; and the agents
    adjacent to agent i that get closer on its cell, and still closer on the chosen one.
    """
    leads_to, agents, cell = planning_view.leads_to, planning_view.agents, planning_view.agents[i].cell
    rank[STAY] += demand[cell] << _HINDRANCE_SHIFT
    for direction in range(4):
        adjacent, entering = leads_to[direction, cell], (direction + 2) & 3
        rank[direction] += (demand[adjacent] - (closer[i] >> direction & 1)) << _HINDRANCE_SHIFT
        behind = planning_view.occupant[adjacent]
        if behind in (NO_AGENT, i) or not closer[behind] >> entering & 1:
            continue
        limit = to_go(planning_view, agents[behind], cell, entering)
        for onward in range(4):
            if to_go(planning_view, agents[behind], leads_to[onward, cell], onward) < limit:
                rank[onward] += 1 << _HINDRANCE_SHIFT
