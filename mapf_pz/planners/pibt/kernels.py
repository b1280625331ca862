"""Priority inheritance with backtracking (PIBT): one step for all agents of one environment, without collisions.

Okumura et al., *Priority Inheritance with Backtracking for Iterative Multi-Agent Path Finding*, AIJ 2022. Agents choose
their next cells in the order of their priorities. Who wants an occupied cell lends its priority to the one in the way,
which must find another cell at once, or tell that there is none.

For agents that turn, the cells are planned in the same way, by the cost to go from cell and heading; an agent keeps the
cell that it has chosen until it is there, and drives only when whoever stands there drives away in the same step (the
causal PIBT of the League of Robot Runners).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapf_pz.actions import Action, CardinalAction
from mapf_pz.core.jit import jit
from mapf_pz.core.state import WAIT_WEIGHT, Array, PlanningView
from mapf_pz.planners.random import draw, seeded

NOBODY, UNDECIDED, STAY = -1, -1, 4
NOT_AT_ALL = 2**63 - 1
"""In place of the rank of a choice that an agent does not have."""
LONGEST_WAY = 2.0**24
"""More than any cost to go."""
_FORWARD, _LEFT, _RIGHT, _WAIT = map(int, Action)
CARDINAL_ACTIONS = tuple(int(CardinalAction[name]) for name in ("RIGHT", "DOWN", "LEFT", "UP", "WAIT"))
"""The action that moves towards each heading, and the one that stays."""


class PibtState(NamedTuple):
    """What N agents on C cells remember, and scratch."""

    want: Array  # (N,) int32: the cell that each agent gets, or wants to reach; -1: it must choose
    away: Array  # (N,) int32: so many steps an agent is away from its goal, where it shall stay there; -1: not begun
    to_go: Array  # (N,) float32: cost from where it is, or was at first where it shall stay at its goal
    order: Array  # (N,) int32: the agents, the highest priority first
    key: Array  # (N,) float64: what that order is by, the lowest first
    taken: Array  # (C + 1,) int32: the agent that gets each cell; -1: nobody yet
    rank: Array  # (N, 5) int64: of moving in each direction and of staying, the best the lowest; its last 3 bits: which
    tried: Array  # (N,) int64: the rank of the choice that was tried last
    choice: Array  # (N,) int8: the direction of `want`
    asking: Array  # (N,) int32: who waits for the one that it asked to give way
    resolved: Array  # (N,) bool: it is known whether it can drive
    random: Array  # (1,) uint64: the state of the draws between equal choices


def allocate_pibt(planning_view: PlanningView, seed: int) -> PibtState:
    """Make room for an environment's agents and cells; `seed`, not 0, decides between equally good choices."""
    num_agents, cells = planning_view.agents.size, planning_view.occupant.size
    return PibtState(
        want=np.full(num_agents, UNDECIDED, np.int32),
        away=np.full(num_agents, -1, np.int32),
        to_go=np.zeros(num_agents, np.float32),
        order=np.arange(num_agents, dtype=np.int32),
        key=np.zeros(num_agents, np.float64),
        taken=np.full(cells, NOBODY, np.int32),
        rank=np.zeros((num_agents, 5), np.int64),
        tried=np.zeros(num_agents, np.int64),
        choice=np.full(num_agents, STAY, np.int8),
        asking=np.zeros(num_agents, np.int32),
        resolved=np.zeros(num_agents, np.bool_),
        random=seeded(seed),
    )


@jit
def plan(planning_view: PlanningView, passing: bool, state: PibtState, actions: Array) -> None:
    """Write an action (N,) int64 for each agent.

    With `passing`, to pass its goal is all that an agent wants; otherwise it shall stay there.
    """
    agents, rotates = planning_view.agents, planning_view.to_go.shape[2] == 4
    prioritize(planning_view, passing, state)
    state.taken[:] = NOBODY
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
    """Sort the order: who has been away from its goal for longer, if it shall stay there; then who is nearer to it."""
    agents = planning_view.agents
    for i in range(agents.size):
        if passing or state.away[i] < 0:
            state.to_go[i] = to_go(planning_view, agents[i], agents[i].cell, agents[i].heading)
        state.away[i] = 0 if passing or agents[i].cell == agents[i].goal else state.away[i] + 1
    sort_by_priority(state.away, state.to_go, state.order, state.key)


@jit
def sort_by_priority(away: Array, to_go: Array, order: Array, key: Array) -> None:
    """Sort the agents into `order` (N,): who is away for longer comes first, then who is nearer, then by index.

    It begins with the order of the step before, which is nearly right: few must be inserted elsewhere.
    """
    for k in range(order.size):
        i, place = order[k], k
        own = to_go[i] - away[i] * LONGEST_WAY
        while place > 0 and (key[place - 1] > own or (key[place - 1] == own and order[place - 1] > i)):
            key[place], order[place] = key[place - 1], order[place - 1]
            place -= 1
        key[place], order[place] = own, i


@jit
def decide(planning_view: PlanningView, state: PibtState) -> None:
    """Set `state.want` of all agents that are undecided, by the rank of their choices, in `state.order`."""
    for i in state.order:
        if state.want[i] == UNDECIDED:
            _find_cell(planning_view, i, state)


@jit
def _find_cell(planning_view: PlanningView, first: int, state: PibtState) -> None:
    """Find a cell for agent `first`, and for all whom it must ask to give way."""
    leads_to, agents, occupant = planning_view.leads_to, planning_view.agents, planning_view.occupant
    want, taken, asking = state.want, state.taken, state.asking
    asking[0] = first
    state.tried[first] = -1
    depth = 1
    while depth > 0:
        i = asking[depth - 1]
        here, target = agents[i].cell, -1
        while target < 0:
            state.tried[i] = _next_rank(state.rank[i], state.tried[i])
            if state.tried[i] == NOT_AT_ALL:
                break
            choice = state.tried[i] & 7
            cell = here if choice == STAY else leads_to[choice, here]
            if (choice != STAY and cell == here) or taken[cell] != NOBODY:
                continue
            other = occupant[cell]
            if other != NOBODY and other != i and want[other] == here:
                continue  # they would change places
            target, state.choice[i] = cell, choice
        if target < 0:
            want[i], state.choice[i] = here, STAY  # nowhere to go: whoever asked must try something else
            taken[here] = i
            depth -= 1
            continue
        want[i] = target
        taken[target] = i
        other = occupant[target]
        if other == NOBODY or want[other] != UNDECIDED:
            return
        state.tried[other] = -1
        asking[depth] = other
        depth += 1


@jit
def _next_rank(rank: Array, tried: int) -> int:
    """Return the lowest of the ranks (5,) above `tried`, or NOT_AT_ALL."""
    lowest = NOT_AT_ALL
    for one in rank:
        lowest = min(lowest, one if one > tried else NOT_AT_ALL)
    return lowest


@jit
def _rank(planning_view: PlanningView, agent: Array, ties: int, rank: Array) -> None:
    """Rank an agent's choices by the cost to its goal, then by `ties`: 12 random bits for each."""
    cell, rotates = agent.cell, planning_view.to_go.shape[2] == 4
    wait = planning_view.weight[WAIT_WEIGHT, cell]
    for towards in range(4):
        target = planning_view.leads_to[towards, cell]
        turns = (towards - agent.heading) & 3 if rotates else 0
        price = planning_view.weight[towards, cell] + min(turns, 4 - turns) * wait
        rank[towards] = _one_number(price + to_go(planning_view, agent, target, towards), ties, towards)
    staying = np.float32(0.0) if cell == agent.goal else wait + to_go(planning_view, agent, cell, agent.heading)
    rank[STAY] = _one_number(staying, ties, STAY)


@jit
def _one_number(cost: np.float32, ties: int, choice: int) -> int:
    """Pack a choice so that the numbers are in the order of the costs: not negative, their bits are in that order."""
    tie = np.int64(ties >> np.uint64(12 * choice)) & 0xFFF
    return (np.int64(np.float32(cost).view(np.int32)) << 32) | (tie << 3) | choice


@jit
def to_go(planning_view: PlanningView, agent: Array, cell: int, heading: int) -> float:
    """Return the cost from cell and heading to the agent's goal."""
    return planning_view.to_go[planning_view.slot[agent.goal], cell, heading & (planning_view.to_go.shape[2] - 1)]


@jit
def write_cardinal(state: PibtState, actions: Array) -> None:
    """Write the action that takes each agent to the cell that it wants."""
    for i in range(actions.size):
        actions[i] = CARDINAL_ACTIONS[state.choice[i]]


@jit
def _write_rotating(planning_view: PlanningView, state: PibtState, actions: Array) -> None:
    """Write the action that brings each agent nearer to the cell that it wants.

    Turns come first; then it drives if the cell is empty, or is left in this step, also around a cycle.
    """
    agents = planning_view.agents
    for i in range(agents.size):
        towards = state.choice[i]
        turn = (towards - agents[i].heading) & 3
        actions[i] = _WAIT if towards == STAY else (_FORWARD if turn == 0 else (_LEFT if turn == 3 else _RIGHT))
    state.resolved[:] = False
    for i in range(agents.size):
        if actions[i] == _FORWARD and not state.resolved[i]:
            _resolve_queue(planning_view.occupant, state, actions, i)


@jit
def _resolve_queue(occupant: Array, state: PibtState, actions: Array, first: int) -> None:
    """Let the queue from `first` on drive, or wait if the one at its head does not drive away."""
    length, i = 0, first
    while i != NOBODY and actions[i] == _FORWARD and not state.resolved[i]:
        state.asking[length] = i
        length += 1
        state.resolved[i] = True
        i = occupant[state.want[i]]
    if i != NOBODY and actions[i] != _FORWARD:
        for k in range(length):
            actions[state.asking[k]] = _WAIT
