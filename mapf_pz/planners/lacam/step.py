"""The next configuration of LaCAM: one step of PIBT for all agents, with prescribed next cells for some of them.

In plain PIBT, two agents that must change places in a corridor undo each other's steps. Here, one of them anticipates
this: it moves back to a cell where the other can pass, and the other follows (`mapf_pz.planners.corridor`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapf_pz._internal.jit import Array, jit
from mapf_pz.planners.corridor import degree, has_room, must_swap
from mapf_pz.planners.random import draw, seeded
from mapf_pz.simulator.kernels.cost_lookup import cost_at
from mapf_pz.simulator.kernels.state import WAIT_WEIGHT

NO_AGENT, UNDECIDED, STAY = -1, -1, 4


class LacamScratch(NamedTuple):
    """Scratch for N agents on C cells; `want` holds the result."""

    want: Array  # (N,) int32: each agent's next cell
    occupant: Array  # (C + 1,) int32: the agent on each cell; -1: none
    taken: Array  # (C + 1,) int32: the agent that has reserved each cell; -1: none
    choices: Array  # (N, 5) int8: directions, and 4 for staying, the best first
    tried: Array  # (N,) int32: number of choices tried so far
    partner: Array  # (N,) int32: the agent that follows into this one's cell in order to swap; -1: none
    chain: Array  # (N,) int32: agents, each of which has asked the next one to move away
    cost: Array  # (5,) float32: cost of each choice
    tie: Array  # (5,) uint64: random numbers that break ties, lower first
    random: Array  # (1,) uint64: state of the random numbers


def allocate_scratch(num_agents: int, num_cells: int, seed: int) -> LacamScratch:
    """Allocate scratch for N agents on C cells; `seed`, which must not be 0, breaks ties."""
    return LacamScratch(
        want=np.full(num_agents, UNDECIDED, np.int32),
        occupant=np.full(num_cells + 1, NO_AGENT, np.int32),
        taken=np.full(num_cells + 1, NO_AGENT, np.int32),
        choices=np.zeros((num_agents, 5), np.int8),
        tried=np.zeros(num_agents, np.int32),
        partner=np.zeros(num_agents, np.int32),
        chain=np.zeros(num_agents, np.int32),
        cost=np.zeros(5, np.float32),
        tie=np.zeros(5, np.uint64),
        random=seeded(seed),
    )


@jit
def next_cells(problem: Array, cells: Array, order: Array, scratch: LacamScratch) -> bool:
    """Set `scratch.want` for all agents; return whether this was possible without a collision.

    Args:
        problem: a `Problem` without headings.
        cells: (N,) int32, the agents' current cells; `outside` for agents that have disappeared, which stay there.
        order: (N,) int32, the agents, the highest priority first.
        scratch: `want` holds the prescribed cells, each the agent's own or an adjacent one, and `UNDECIDED` elsewhere;
            `occupant` and `taken` hold -1 everywhere, before and after the call.
    """
    gone = outside(problem)
    for i in range(cells.size):
        if cells[i] == gone:
            scratch.want[i] = gone
        else:
            scratch.occupant[cells[i]] = i
    # Prescribed cells first, as agents of PIBT only move to cells that are not reserved yet.
    legal = _prescribe(cells, gone, scratch)
    if legal:
        for i in order:
            # An agent without a cell makes the whole configuration fail: with prescribed cells, PIBT has no guarantee
            # to find one.
            if scratch.want[i] == UNDECIDED and not _decide(problem, cells, scratch, i):
                legal = False
                break
    for i in range(cells.size):
        # Only what was written is cleared, not all cells of the map.
        scratch.occupant[cells[i]] = NO_AGENT
        if scratch.want[i] != UNDECIDED:
            scratch.taken[scratch.want[i]] = NO_AGENT
    return legal


@jit
def outside(problem: Array) -> int:
    """Return the cell outside of the map, where agents are that have disappeared."""
    return problem.leads_to.shape[1] - 1


@jit
def _prescribe(cells: Array, gone: int, scratch: LacamScratch) -> bool:
    for i in range(cells.size):
        cell = scratch.want[i]
        if cell in (UNDECIDED, gone):
            continue
        other = scratch.occupant[cell]
        if scratch.taken[cell] != NO_AGENT or (other != NO_AGENT and other != i and scratch.want[other] == cells[i]):
            return False
        scratch.taken[cell] = i
    return True


@jit
def _decide(problem: Array, cells: Array, scratch: LacamScratch, first: int) -> bool:
    """Find a cell for agent `first`, and for all agents that must move away for it; return whether there is one."""
    want, taken, occupant, chain = scratch.want, scratch.taken, scratch.occupant, scratch.chain
    # PIBT's recursion (Okumura et al., Artificial Intelligence 310, 2022) as a loop: an agent inherits the priority of
    # the agent before it in the chain, which wants its cell.
    chain[0] = first
    depth = 1
    _prepare(problem, cells, scratch, first)
    while depth > 0:
        i = chain[depth - 1]
        target = _next_choice(problem.leads_to, cells, scratch, i)
        if target == UNDECIDED:
            want[i] = cells[i]  # no cell is left: the agent before it in the chain must try another one
            taken[cells[i]] = i
            depth -= 1
            continue
        want[i] = target
        taken[target] = i
        other = occupant[target]
        # The cell is free, or its agent leaves it: the chain ends, and all of its agents can move.
        if other == NO_AGENT or want[other] != UNDECIDED:
            _pull_partners(cells, scratch, depth)
            return True
        _prepare(problem, cells, scratch, other)
        chain[depth] = other
        depth += 1
    return False


@jit
def _next_choice(leads_to: Array, cells: Array, scratch: LacamScratch, i: int) -> int:
    """Return the next available cell among agent i's choices, or `UNDECIDED` if none is left."""
    while scratch.tried[i] < 5:
        choice = scratch.choices[i, scratch.tried[i]]
        scratch.tried[i] += 1
        cell = cells[i] if choice == STAY else leads_to[choice, cells[i]]
        # A blocked move would be a second choice to stay.
        if (choice != STAY and cell == cells[i]) or scratch.taken[cell] != NO_AGENT:
            continue
        other = scratch.occupant[cell]
        if other != NO_AGENT and other != i and scratch.want[other] == cells[i]:
            continue  # they would swap
        return cell
    return UNDECIDED


@jit
def _pull_partners(cells: Array, scratch: LacamScratch, depth: int) -> None:
    """Let partners follow the agents of the chain that got their first choices."""
    for k in range(depth - 1, -1, -1):
        i = scratch.chain[k]
        partner = scratch.partner[i]
        # If the agent had to take another cell, it does not move away as the swap requires.
        first_choice = scratch.tried[i] == 1
        if (
            first_choice
            and partner != NO_AGENT
            and scratch.want[partner] == UNDECIDED
            and scratch.taken[cells[i]] == NO_AGENT
        ):
            scratch.want[partner] = cells[i]
            scratch.taken[cells[i]] = partner


@jit
def _prepare(problem: Array, cells: Array, scratch: LacamScratch, i: int) -> None:
    """Sort agent i's choices by the cost to its goal, or in reverse if it must swap with another agent."""
    leads_to, weight, cell, choices = problem.leads_to, problem.weight, cells[i], scratch.choices[i]
    for direction in range(4):
        scratch.cost[direction] = weight[direction, cell] + _to_go(problem, i, leads_to[direction, cell])
    scratch.cost[STAY] = 0.0 if cell == problem.goals[i] else weight[WAIT_WEIGHT, cell] + _to_go(problem, i, cell)
    for k in range(5):
        scratch.tie[k] = draw(scratch.random)
        position = k
        while position > 0 and _before(scratch.cost, scratch.tie, k, choices[position - 1]):
            choices[position] = choices[position - 1]
            position -= 1
        choices[position] = k
    scratch.tried[i] = 0
    first = choices[0]
    scratch.partner[i] = NO_AGENT if first == STAY else _find_partner(problem, cells, scratch, i, leads_to[first, cell])
    if scratch.partner[i] != NO_AGENT:
        # A puller moves away from its goal: its choices in reverse, from the worst to the best.
        last = degree(leads_to, cell)  # blocked choices come after it
        for k in range((last + 1) // 2):
            choices[k], choices[last - k] = choices[last - k], choices[k]


@jit
def _before(cost: Array, tie: Array, one: int, other: int) -> bool:
    return cost[one] < cost[other] or (cost[one] == cost[other] and tie[one] < tie[other])


@jit
def _find_partner(problem: Array, cells: Array, scratch: LacamScratch, i: int, best: int) -> int:
    """Return the agent that agent i, whose best cell is `best`, must swap with, or NO_AGENT."""
    leads_to, occupant, cell = problem.leads_to, scratch.occupant, cells[i]
    ahead = occupant[best]
    # Either the agent ahead must get past agent i, or one beside it would follow into the corridor ahead, and have to
    # get past it there. In both cases, there must be a branch on the way back (Okumura, IJCAI 2023).
    if (
        ahead != NO_AGENT
        and scratch.want[ahead] == UNDECIDED
        and _must_swap(problem, occupant, i, ahead, cell, best)
        and has_room(leads_to, problem.goals, occupant, best, cell)
    ):
        return ahead
    for direction in range(4):
        beside = leads_to[direction, cell]
        behind = occupant[beside]
        if (
            beside != cell
            and beside != best
            and behind != NO_AGENT
            and _must_swap(problem, occupant, behind, i, cell, best)
            and has_room(leads_to, problem.goals, occupant, best, cell)
        ):
            return behind
    return NO_AGENT


@jit
def _must_swap(problem: Array, occupant: Array, pusher: int, puller: int, back: int, front: int) -> bool:
    """Return whether a pusher on `back` and a puller on `front` must change places along the corridor ahead."""
    tables = problem.table
    return must_swap(
        problem.leads_to, problem.to_go, problem.goals, occupant, tables[pusher], tables[puller], back, front
    )


@jit
def _to_go(problem: Array, agent: int, cell: int) -> np.float32:
    return cost_at(problem.to_go, problem.table[agent], cell, 0)
