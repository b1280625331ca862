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

from mapf_pz.core.jit import jit
from mapf_pz.core.state import WAIT_WEIGHT, Array
from mapf_pz.types import Action, CardinalAction

NOBODY, UNDECIDED, STAY = -1, -1, 4
_FORWARD, _LEFT, _RIGHT, _WAIT = map(int, Action)
_CARDINAL_ACTION = tuple(int(CardinalAction[name]) for name in ("RIGHT", "DOWN", "LEFT", "UP", "WAIT"))


class Desk(NamedTuple):
    """Scratch for N agents on C cells; `want` holds the result."""

    want: Array  # (N,) int32: the cell that each agent gets, or wants to reach
    taken: Array  # (C + 1,) int32: the agent that gets each cell; -1: nobody yet
    choices: Array  # (N, 5) int8: directions, and 4 for staying, the best first
    tried: Array  # (N,) int32: how many of them were tried
    asking: Array  # (N,) int32: who waits for the one that it asked to give way
    cost: Array  # (5,) float32


def allocate_desk(num_agents: int, num_cells: int) -> Desk:
    """Make room for N agents on C cells."""
    return Desk(
        want=np.full(num_agents, UNDECIDED, np.int32),
        taken=np.full(num_cells + 1, NOBODY, np.int32),
        choices=np.zeros((num_agents, 5), np.int8),
        tried=np.zeros(num_agents, np.int32),
        asking=np.zeros(num_agents, np.int32),
        cost=np.zeros(5, np.float32),
    )


@jit
def plan_cells(
    leads_to: Array, weight: Array, slot: Array, to_go: Array, crew: Array, occupant: Array, order: Array, ties: Array,
    desk: Desk
) -> None:  # fmt: skip
    """Set `desk.want` for all agents; those that want a cell already (not `UNDECIDED`) keep it.

    `leads_to` (4, C + 1), `weight` (5, C + 1) and `slot` (C + 1,) are those of one map; `order` (N,) begins with the
    highest priority; of equal choices, the one with the lowest of `ties` (N, 5) comes first.
    """
    desk.taken[:] = NOBODY
    for i in range(crew.size):
        if not crew[i].active:
            desk.want[i] = crew[i].cell
        elif desk.want[i] != UNDECIDED:
            desk.taken[desk.want[i]] = i
    for i in order:
        if desk.want[i] == UNDECIDED:
            _decide(leads_to, weight, slot, to_go, crew, occupant, ties, i, desk)


@jit
def _decide(
    leads_to: Array, weight: Array, slot: Array, to_go: Array, crew: Array, occupant: Array, ties: Array, first: int,
    desk: Desk
) -> None:  # fmt: skip
    """Find a cell for agent `first`, and for all whom it must ask to give way."""
    want, taken, asking = desk.want, desk.taken, desk.asking
    asking[0] = first
    depth = 1
    _rank(leads_to, weight, to_go[slot[crew[first].goal]], crew[first], ties[first], desk.choices[first], desk.cost)
    desk.tried[first] = 0
    while depth > 0:
        i = asking[depth - 1]
        agent = crew[i]
        target = -1
        while desk.tried[i] < 5:
            choice = desk.choices[i, desk.tried[i]]
            desk.tried[i] += 1
            cell = agent.cell if choice == STAY else leads_to[choice, agent.cell]
            if (choice != STAY and cell == agent.cell) or taken[cell] != NOBODY:
                continue
            other = occupant[cell]
            if other != NOBODY and other != i and want[other] == agent.cell:
                continue  # they would change places
            target = cell
            break
        if target < 0:
            want[i] = agent.cell  # nowhere to go: whoever asked must try something else
            taken[agent.cell] = i
            depth -= 1
            continue
        want[i] = target
        taken[target] = i
        other = occupant[target]
        in_the_way = other != NOBODY and want[other] == UNDECIDED
        if not in_the_way:
            return
        _rank(leads_to, weight, to_go[slot[crew[other].goal]], crew[other], ties[other], desk.choices[other], desk.cost)
        desk.tried[other] = 0
        asking[depth] = other
        depth += 1


@jit
def _rank(leads_to: Array, weight: Array, to_go: Array, agent: Array, ties: Array, choices: Array, cost: Array) -> None:
    """Sort an agent's choices by the cost to its goal; `to_go` (C + 1, D) is its table."""
    cell, rotates = agent.cell, to_go.shape[1] == 4
    wait = weight[WAIT_WEIGHT, cell]
    for towards in range(4):
        target = leads_to[towards, cell]
        turns = (towards - agent.heading) % 4 if rotates else 0
        cost[towards] = weight[towards, cell] + to_go[target, towards % to_go.shape[1]] + min(turns, 4 - turns) * wait
    cost[STAY] = 0.0 if cell == agent.goal else wait + to_go[cell, agent.heading % to_go.shape[1]]
    for k in range(5):
        place = k
        while place > 0 and _before(cost, ties, k, choices[place - 1]):
            choices[place] = choices[place - 1]
            place -= 1
        choices[place] = k


@jit
def _before(cost: Array, ties: Array, one: int, other: int) -> bool:
    return cost[one] < cost[other] or (cost[one] == cost[other] and ties[one] < ties[other])


@jit
def cardinal_actions(leads_to: Array, crew: Array, want: Array, actions: Array) -> None:
    """Write the action (N,) int64 that takes each agent to the cell that it wants."""
    for i in range(crew.size):
        choice = STAY
        for towards in range(4):
            if want[i] != crew[i].cell and leads_to[towards, crew[i].cell] == want[i]:
                choice = towards
        actions[i] = _CARDINAL_ACTION[choice]


@jit
def rotating_actions(leads_to: Array, crew: Array, occupant: Array, want: Array, asking: Array, actions: Array) -> None:
    """Write the action (N,) int64 that brings each agent nearer to the cell that it wants.

    Turns come first; then it drives if the cell is empty, or is left in this step, also around a cycle.
    """
    for i in range(crew.size):
        actions[i] = _WAIT
        for towards in range(4):
            if want[i] != crew[i].cell and leads_to[towards, crew[i].cell] == want[i]:
                turn = (towards - crew[i].heading) % 4
                actions[i] = _FORWARD if turn == 0 else (_LEFT if turn == 3 else _RIGHT)
    for i in range(crew.size):
        if actions[i] == _FORWARD:
            _hold_unless_way_clears(crew, occupant, want, asking, actions, i)


@jit
def _hold_unless_way_clears(
    crew: Array, occupant: Array, want: Array, asking: Array, actions: Array, first: int
) -> None:
    """Turn forward moves into waits from `first` on along the queue, if the one at its head does not drive away."""
    length, i = 0, first
    while i != NOBODY and actions[i] == _FORWARD:
        asking[length] = i
        length += 1
        i = occupant[want[i]]
        if i == first or length == crew.size:
            return  # a cycle: all of them drive
    if i != NOBODY:
        for k in range(length):
            actions[asking[k]] = _WAIT
