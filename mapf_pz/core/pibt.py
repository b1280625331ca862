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
LONGEST_WAY = 2.0**24
"""More than any cost to go."""
_FORWARD, _LEFT, _RIGHT, _WAIT = map(int, Action)
CARDINAL_ACTIONS = tuple(int(CardinalAction[name]) for name in ("RIGHT", "DOWN", "LEFT", "UP", "WAIT"))
"""The action that moves towards each heading, and the one that stays."""


class Desk(NamedTuple):
    """What N agents on C cells remember, and scratch."""

    want: Array  # (N,) int32: the cell that each agent gets, or wants to reach; -1: it must choose
    away: Array  # (N,) int32: so many steps an agent is away from its goal, where it shall stay there; -1: not begun
    to_go: Array  # (N,) float32: cost from where it is, or was at first where it shall stay at its goal
    order: Array  # (N,) int32: the agents, the highest priority first
    taken: Array  # (C + 1,) int32: the agent that gets each cell; -1: nobody yet
    choices: Array  # (N, 5) int8: directions, and 4 for staying, the best first
    tried: Array  # (N,) int32: how many of them were tried
    asking: Array  # (N,) int32: who waits for the one that it asked to give way
    cost: Array  # (5,) float32


def allocate_desk(num_agents: int, num_cells: int) -> Desk:
    """Make room for N agents on C cells."""
    return Desk(
        want=np.full(num_agents, UNDECIDED, np.int32),
        away=np.full(num_agents, -1, np.int32),
        to_go=np.zeros(num_agents, np.float32),
        order=np.arange(num_agents, dtype=np.int32),
        taken=np.full(num_cells + 1, NOBODY, np.int32),
        choices=np.zeros((num_agents, 5), np.int8),
        tried=np.zeros(num_agents, np.int32),
        asking=np.zeros(num_agents, np.int32),
        cost=np.zeros(5, np.float32),
    )


@jit
def plan(
    leads_to: Array, weight: Array, slot: Array, to_go: Array, crew: Array, occupant: Array, ties: Array,
    passing: bool, desk: Desk, actions: Array
) -> None:  # fmt: skip
    """Write an action (N,) int64 for each agent.

    `leads_to` (4, C + 1), `weight` (5, C + 1), `slot` (C + 1,) and `occupant` (C + 1,) are those of one environment and
    its map; of equal choices, the one with the lowest of `ties` (N, 5) comes first. With `passing`, to pass its goal is
    all that an agent wants; otherwise it shall stay there.
    """
    rotates = to_go.shape[2] == 4
    prioritize(slot, to_go, crew, passing, desk)
    desk.taken[:] = NOBODY
    for i in range(crew.size):
        if not crew[i].active:
            desk.want[i] = crew[i].cell
        elif rotates and desk.want[i] != UNDECIDED and desk.want[i] != crew[i].cell:
            desk.taken[desk.want[i]] = i
        else:
            desk.want[i] = UNDECIDED
            _rank(leads_to, weight, to_go[slot[crew[i].goal]], crew[i], ties[i], desk.choices[i], desk.cost)
    decide(leads_to, crew, occupant, desk)
    if rotates:
        _write_rotating(leads_to, crew, occupant, desk, actions)
    else:
        write_cardinal(leads_to, crew, desk.want, actions)


@jit
def prioritize(slot: Array, to_go: Array, crew: Array, passing: bool, desk: Desk) -> None:
    """Sort the order: who has been away from its goal for longer, if it shall stay there; then who is nearer to it."""
    for i in range(crew.size):
        if passing or desk.away[i] < 0:
            table = to_go[slot[crew[i].goal]]
            desk.to_go[i] = table[crew[i].cell, crew[i].heading % table.shape[1]]
        desk.away[i] = 0 if passing or crew[i].cell == crew[i].goal else desk.away[i] + 1
    sort_by_priority(desk.away, desk.to_go, desk.order)


@jit
def sort_by_priority(away: Array, to_go: Array, order: Array) -> None:
    """Sort the agents into `order` (N,): who is away for longer comes first, then who is nearer, then by index."""
    order[:] = np.argsort(to_go - away * LONGEST_WAY, kind="mergesort")


@jit
def decide(leads_to: Array, crew: Array, occupant: Array, desk: Desk) -> None:
    """Set `desk.want` of all agents that are undecided, by their `desk.choices`, in `desk.order`."""
    for i in desk.order:
        if desk.want[i] == UNDECIDED:
            _find_cell(leads_to, crew, occupant, i, desk)


@jit
def _find_cell(leads_to: Array, crew: Array, occupant: Array, first: int, desk: Desk) -> None:
    """Find a cell for agent `first`, and for all whom it must ask to give way."""
    want, taken, asking = desk.want, desk.taken, desk.asking
    asking[0] = first
    desk.tried[first] = 0
    depth = 1
    while depth > 0:
        i = asking[depth - 1]
        here, target = crew[i].cell, -1
        while desk.tried[i] < 5:
            choice = desk.choices[i, desk.tried[i]]
            desk.tried[i] += 1
            cell = here if choice == STAY else leads_to[choice, here]
            if (choice != STAY and cell == here) or taken[cell] != NOBODY:
                continue
            other = occupant[cell]
            if other != NOBODY and other != i and want[other] == here:
                continue  # they would change places
            target = cell
            break
        if target < 0:
            want[i] = here  # nowhere to go: whoever asked must try something else
            taken[here] = i
            depth -= 1
            continue
        want[i] = target
        taken[target] = i
        other = occupant[target]
        if other == NOBODY or want[other] != UNDECIDED:
            return
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
def write_cardinal(leads_to: Array, crew: Array, want: Array, actions: Array) -> None:
    """Write the action that takes each agent to the cell that it wants."""
    for i in range(crew.size):
        actions[i] = CARDINAL_ACTIONS[_direction(leads_to, crew[i].cell, want[i])]


@jit
def _write_rotating(leads_to: Array, crew: Array, occupant: Array, desk: Desk, actions: Array) -> None:
    """Write the action that brings each agent nearer to the cell that it wants.

    Turns come first; then it drives if the cell is empty, or is left in this step, also around a cycle.
    """
    for i in range(crew.size):
        towards = _direction(leads_to, crew[i].cell, desk.want[i])
        turn = (towards - crew[i].heading) % 4
        actions[i] = _WAIT if towards == STAY else (_FORWARD if turn == 0 else (_LEFT if turn == 3 else _RIGHT))
    desk.tried[:] = 0  # 1: it drives
    for i in range(crew.size):
        if actions[i] == _FORWARD and desk.tried[i] == 0:
            _settle_queue(crew, occupant, desk, actions, i)


@jit
def _direction(leads_to: Array, cell: int, target: int) -> int:
    """Return the heading that leads from a cell to a neighbour, or STAY."""
    for towards in range(4):
        if target != cell and leads_to[towards, cell] == target:
            return towards
    return STAY


@jit
def _settle_queue(crew: Array, occupant: Array, desk: Desk, actions: Array, first: int) -> None:
    """Let the queue from `first` on drive, or wait if the one at its head does not drive away."""
    length, i = 0, first
    while i != NOBODY and actions[i] == _FORWARD and desk.tried[i] == 0:
        desk.asking[length] = i
        length += 1
        desk.tried[i] = 1
        i = occupant[desk.want[i]]
    if i != NOBODY and actions[i] != _FORWARD:
        for k in range(length):
            actions[desk.asking[k]] = _WAIT
