"""Priority inheritance with backtracking (PIBT): one collision-free step of all agents of one environment.

Okumura et al., *Priority Inheritance with Backtracking for Iterative Multi-Agent Path Finding*, AIJ 2022. Agents choose
their next cells in priority order. An agent that wants an occupied cell lends its priority to the occupant, which must
find another cell at once, or report that there is none.

For rotating agents, cells are chosen in the same way, by the cost to go from cell and heading. An agent keeps its
chosen cell until it gets there, and enters it only if the cell is empty or its occupant leaves in the same step (the
causal PIBT of the League of Robot Runners).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapf_pz.actions import Action, CardinalAction
from mapf_pz.core.cost_lookup import cost_at, num_headings
from mapf_pz.core.jit import jit
from mapf_pz.core.state import WAIT_WEIGHT, Array, PlanningView
from mapf_pz.planners.random import draw, seeded

NO_AGENT, UNDECIDED, STAY = -1, -1, 4
NO_RANK = 2**63 - 1
"""The rank of a choice that is not available."""
COST_BOUND = 2.0**24
"""Larger than any cost to go."""
_FORWARD, _LEFT, _RIGHT, _WAIT = map(int, Action)
CARDINAL_ACTIONS = tuple(int(CardinalAction[name]) for name in ("RIGHT", "DOWN", "LEFT", "UP", "WAIT"))
"""The action that moves in the direction of each heading, and the wait action."""


class PibtState(NamedTuple):
    """State of N agents on C cells between steps, and scratch."""

    want: Array  # (N,) int32: the cell that each agent has reserved or wants to reach; -1: undecided
    away: Array  # (N,) int32: steps since the agent was at its goal if agents must stay there; -1: first step
    to_go: Array  # (N,) float32: cost to go from the agent's state, or from its first state if agents must stay
    order: Array  # (N,) int32: the agents, the highest priority first
    key: Array  # (N,) float64: the sort key of that order, ascending
    taken: Array  # (C + 1,) int32: the agent that has reserved each cell; -1: none
    rank: Array  # (N, 5) int64: of moving in each direction and of staying, lower is better; last 3 bits: the choice
    tried: Array  # (N,) int64: the rank of the last tried choice
    choice: Array  # (N,) int8: the direction of `want`
    chain: Array  # (N,) int32: agents, each of which has asked the next one to move away
    resolved: Array  # (N,) bool: whether it is known if the agent can move
    random: Array  # (1,) uint64: state of the random numbers that break ties


def allocate_pibt(planning_view: PlanningView, seed: int) -> PibtState:
    """Allocate the state for an environment; `seed`, which must not be 0, breaks ties."""
    num_agents, cells = planning_view.agents.size, planning_view.occupant.size
    return PibtState(
        want=np.full(num_agents, UNDECIDED, np.int32),
        away=np.full(num_agents, -1, np.int32),
        to_go=np.zeros(num_agents, np.float32),
        order=np.arange(num_agents, dtype=np.int32),
        key=np.zeros(num_agents, np.float64),
        taken=np.full(cells, NO_AGENT, np.int32),
        rank=np.zeros((num_agents, 5), np.int64),
        tried=np.zeros(num_agents, np.int64),
        choice=np.full(num_agents, STAY, np.int8),
        chain=np.zeros(num_agents, np.int32),
        resolved=np.zeros(num_agents, np.bool_),
        random=seeded(seed),
    )


@jit
def plan(planning_view: PlanningView, passing: bool, state: PibtState, actions: Array) -> None:
    """Write an action (N,) int64 for each agent.

    With `passing`, an agent only has to pass its goal; otherwise it must stay there.
    """
    agents, rotates = planning_view.agents, num_headings(planning_view.to_go) == 4
    prioritize(planning_view, passing, state)
    state.taken[:] = NO_AGENT
    for i in range(agents.size):
        if not agents[i].active:
            state.want[i], state.choice[i] = agents[i].cell, STAY
        elif rotates and state.want[i] != UNDECIDED and state.want[i] != agents[i].cell:
            state.taken[state.want[i]] = i
        else:
            state.want[i] = UNDECIDED
            _rank(planning_view, agents[i], draw(state.random), state.rank[i])
    decide(planning_view, state)
    if rotates:
        _write_rotating(planning_view, state, actions)
    else:
        write_cardinal(state, actions)


@jit
def prioritize(planning_view: PlanningView, passing: bool, state: PibtState) -> None:
    """Sort the agents by priority: by their time away from their goals if they must stay there, then by cost to go."""
    agents = planning_view.agents
    for i in range(agents.size):
        if passing or state.away[i] < 0:
            state.to_go[i] = to_go(planning_view, agents[i], agents[i].cell, agents[i].heading)
        state.away[i] = 0 if passing or agents[i].cell == agents[i].goal else state.away[i] + 1
    sort_by_priority(state.away, state.to_go, state.order, state.key)


@jit
def sort_by_priority(away: Array, to_go: Array, order: Array, key: Array) -> None:
    """Sort the agents `order` (N,): by `away`, descending, then by `to_go`, ascending, then by index.

    This is an insertion sort that starts from the order of the previous step, which is nearly correct.
    """
    for k in range(order.size):
        i, position = order[k], k
        own = to_go[i] - away[i] * COST_BOUND
        while position > 0 and (key[position - 1] > own or (key[position - 1] == own and order[position - 1] > i)):
            key[position], order[position] = key[position - 1], order[position - 1]
            position -= 1
        key[position], order[position] = own, i


@jit
def decide(planning_view: PlanningView, state: PibtState) -> None:
    """Set `state.want` of all undecided agents, in `state.order`, by the ranks of their choices."""
    for i in state.order:
        if state.want[i] == UNDECIDED:
            _find_cell(planning_view, i, state)


@jit
def _find_cell(planning_view: PlanningView, first: int, state: PibtState) -> None:
    """Find a cell for agent `first`, and for all agents that must move away for it."""
    leads_to, agents, occupant = planning_view.leads_to, planning_view.agents, planning_view.occupant
    want, taken, chain = state.want, state.taken, state.chain
    chain[0] = first
    state.tried[first] = -1
    depth = 1
    while depth > 0:
        i = chain[depth - 1]
        here, target = agents[i].cell, -1
        while target < 0:
            state.tried[i] = _next_rank(state.rank[i], state.tried[i])
            if state.tried[i] == NO_RANK:
                break
            choice = state.tried[i] & 7
            cell = here if choice == STAY else leads_to[choice, here]
            if (choice != STAY and cell == here) or taken[cell] != NO_AGENT:
                continue
            other = occupant[cell]
            if other != NO_AGENT and other != i and want[other] == here:
                continue  # they would swap
            target, state.choice[i] = cell, choice
        if target < 0:
            # No cell is left: the previous agent in the chain must try another one.
            want[i], state.choice[i] = here, STAY
            taken[here] = i
            depth -= 1
            continue
        want[i] = target
        taken[target] = i
        other = occupant[target]
        if other == NO_AGENT or want[other] != UNDECIDED:
            return
        state.tried[other] = -1
        chain[depth] = other
        depth += 1


@jit
def _next_rank(rank: Array, tried: int) -> int:
    """Return the lowest of the ranks (5,) above `tried`, or NO_RANK."""
    lowest = NO_RANK
    for candidate in rank:
        lowest = min(lowest, candidate if candidate > tried else NO_RANK)
    return lowest


@jit
def _rank(planning_view: PlanningView, agent: Array, ties: int, rank: Array) -> None:
    """Rank an agent's choices by the cost to its goal, then by `ties`: 12 random bits per choice."""
    cell, rotates = agent.cell, num_headings(planning_view.to_go) == 4
    wait = planning_view.weight[WAIT_WEIGHT, cell]
    for direction in range(4):
        target = planning_view.leads_to[direction, cell]
        turns = (direction - agent.heading) & 3 if rotates else 0
        cost = planning_view.weight[direction, cell] + min(turns, 4 - turns) * wait
        rank[direction] = _pack(cost + to_go(planning_view, agent, target, direction), ties, direction)
    staying = np.float32(0.0) if cell == agent.goal else wait + to_go(planning_view, agent, cell, agent.heading)
    rank[STAY] = _pack(staying, ties, STAY)


@jit
def _pack(cost: np.float32, ties: int, choice: int) -> int:
    """Pack a choice into one integer that sorts by cost: the bits of non-negative floats sort as the floats do."""
    tie = np.int64(ties >> np.uint64(12 * choice)) & 0xFFF
    return (np.int64(np.float32(cost).view(np.int32)) << 32) | (tie << 3) | choice


@jit
def to_go(planning_view: PlanningView, agent: Array, cell: int, heading: int) -> np.float32:
    """Return the cost to go from a cell and heading to the agent's goal."""
    return cost_at(planning_view.to_go, planning_view.slot[agent.goal], cell, heading)


@jit
def write_cardinal(state: PibtState, actions: Array) -> None:
    """Write the action that moves each agent to the cell in `state.want`."""
    for i in range(actions.size):
        actions[i] = CARDINAL_ACTIONS[state.choice[i]]


@jit
def _write_rotating(planning_view: PlanningView, state: PibtState, actions: Array) -> None:
    """Write the action that brings each agent closer to the cell in `state.want`.

    Agents turn first. Then they move forward if the cell is empty or its occupant leaves it in this step, which may be
    around a cycle.
    """
    agents = planning_view.agents
    for i in range(agents.size):
        direction = state.choice[i]
        turn = (direction - agents[i].heading) & 3
        actions[i] = _WAIT if direction == STAY else (_FORWARD if turn == 0 else (_LEFT if turn == 3 else _RIGHT))
    state.resolved[:] = False
    for i in range(agents.size):
        if actions[i] == _FORWARD and not state.resolved[i]:
            _resolve_queue(planning_view.occupant, state, actions, i)


@jit
def _resolve_queue(occupant: Array, state: PibtState, actions: Array, first: int) -> None:
    """Let the queue that starts with `first` move forward, or wait if the agent at its head does not move away."""
    length, i = 0, first
    while i != NO_AGENT and actions[i] == _FORWARD and not state.resolved[i]:
        state.chain[length] = i
        length += 1
        state.resolved[i] = True
        i = occupant[state.want[i]]
    if i != NO_AGENT and actions[i] != _FORWARD:
        for k in range(length):
            actions[state.chain[k]] = _WAIT
