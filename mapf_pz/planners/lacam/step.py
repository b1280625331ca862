"""The next configuration of LaCAM: one step of PIBT for all agents, in which some have their next cells prescribed.

Two agents that must change places in a corridor undo each other's steps in plain PIBT. Here one of them foresees it: it
backs off to a cell where there is room to let the other pass, and pulls the other behind it (the swap of
"Engineering LaCAM*", Okumura, AAMAS 2024).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapf_pz.core.jit import jit
from mapf_pz.core.state import WAIT_WEIGHT, Array
from mapf_pz.planners.random import draw, seeded

NOBODY, UNDECIDED, STAY = -1, -1, 4


class LacamScratch(NamedTuple):
    """Scratch for N agents on C cells; `want` holds the result."""

    want: Array  # (N,) int32: the cell that each agent gets
    occupant: Array  # (C + 1,) int32: the agent on each cell; -1: nobody
    taken: Array  # (C + 1,) int32: the agent that gets each cell; -1: nobody yet
    choices: Array  # (N, 5) int8: directions, and 4 for staying, the best first
    tried: Array  # (N,) int32: how many of them were tried
    partner: Array  # (N,) int32: the agent that follows into this one's cell, to change places with it; -1: none
    asking: Array  # (N,) int32: who waits for the one that it asked to give way
    cost: Array  # (5,) float32: of each choice
    tie: Array  # (5,) uint64: of equally cheap choices, the lowest comes first
    random: Array  # (1,) uint64: the state of the draws, not 0


def allocate_scratch(num_agents: int, num_cells: int, seed: int) -> LacamScratch:
    """Make room for N agents on C cells; `seed`, at least 1, decides between equally good choices."""
    return LacamScratch(
        want=np.full(num_agents, UNDECIDED, np.int32),
        occupant=np.full(num_cells + 1, NOBODY, np.int32),
        taken=np.full(num_cells + 1, NOBODY, np.int32),
        choices=np.zeros((num_agents, 5), np.int8),
        tried=np.zeros(num_agents, np.int32),
        partner=np.zeros(num_agents, np.int32),
        asking=np.zeros(num_agents, np.int32),
        cost=np.zeros(5, np.float32),
        tie=np.zeros(5, np.uint64),
        random=seeded(seed),
    )


@jit
def next_cells(problem: Array, cells: Array, order: Array, scratch: LacamScratch) -> bool:
    """Set `scratch.want` for all agents, and return whether that could be done without a collision.

    Args:
        problem: a `Problem` of the planners, for agents without headings.
        cells: (N,) int32, where the agents are.
        order: (N,) int32, the agents, the highest priority first.
        scratch: `want` holds the cells that are prescribed, each a neighbour or the own one, and `UNDECIDED` elsewhere;
            `occupant` and `taken` hold -1 everywhere, also afterwards.
    """
    for i in range(cells.size):
        scratch.occupant[cells[i]] = i
    legal = _prescribe(cells, scratch)
    if legal:
        for i in order:
            if scratch.want[i] == UNDECIDED and not _decide(problem, cells, scratch, i):
                legal = False
                break
    for i in range(cells.size):
        scratch.occupant[cells[i]] = NOBODY
        if scratch.want[i] != UNDECIDED:
            scratch.taken[scratch.want[i]] = NOBODY
    return legal


@jit
def _prescribe(cells: Array, scratch: LacamScratch) -> bool:
    for i in range(cells.size):
        cell = scratch.want[i]
        if cell == UNDECIDED:
            continue
        other = scratch.occupant[cell]
        if scratch.taken[cell] != NOBODY or (other != NOBODY and other != i and scratch.want[other] == cells[i]):
            return False
        scratch.taken[cell] = i
    return True


@jit
def _decide(problem: Array, cells: Array, scratch: LacamScratch, first: int) -> bool:
    """Find a cell for agent `first` and for all whom it must ask to give way; return whether there is one."""
    want, taken, occupant, asking = scratch.want, scratch.taken, scratch.occupant, scratch.asking
    asking[0] = first
    depth = 1
    _prepare(problem, cells, scratch, first)
    while depth > 0:
        i = asking[depth - 1]
        target = _next_choice(problem.leads_to, cells, scratch, i)
        if target == UNDECIDED:
            want[i] = cells[i]  # nowhere to go: whoever asked must try something else
            taken[cells[i]] = i
            depth -= 1
            continue
        want[i] = target
        taken[target] = i
        other = occupant[target]
        if other == NOBODY or want[other] != UNDECIDED:
            _pull_partners(cells, scratch, depth)
            return True
        _prepare(problem, cells, scratch, other)
        asking[depth] = other
        depth += 1
    return False


@jit
def _next_choice(leads_to: Array, cells: Array, scratch: LacamScratch, i: int) -> int:
    """Return the next of agent i's cells that it could have; `UNDECIDED`: none is left."""
    while scratch.tried[i] < 5:
        choice = scratch.choices[i, scratch.tried[i]]
        scratch.tried[i] += 1
        cell = cells[i] if choice == STAY else leads_to[choice, cells[i]]
        if (choice != STAY and cell == cells[i]) or scratch.taken[cell] != NOBODY:
            continue
        other = scratch.occupant[cell]
        if other != NOBODY and other != i and scratch.want[other] == cells[i]:
            continue  # they would change places
        return cell
    return UNDECIDED


@jit
def _pull_partners(cells: Array, scratch: LacamScratch, depth: int) -> None:
    """Let partners follow those of the first `depth` in `scratch.asking` that got their first choices."""
    for k in range(depth - 1, -1, -1):
        i = scratch.asking[k]
        partner = scratch.partner[i]
        first_choice = scratch.tried[i] == 1
        if (
            first_choice
            and partner != NOBODY
            and scratch.want[partner] == UNDECIDED
            and scratch.taken[cells[i]] == NOBODY
        ):
            scratch.want[partner] = cells[i]
            scratch.taken[cells[i]] = partner


@jit
def _prepare(problem: Array, cells: Array, scratch: LacamScratch, i: int) -> None:
    """Sort agent i's choices by the cost to its goal; the other way round where it must change places with another."""
    leads_to, weight, cell, choices = problem.leads_to, problem.weight, cells[i], scratch.choices[i]
    for towards in range(4):
        scratch.cost[towards] = weight[towards, cell] + _to_go(problem, i, leads_to[towards, cell])
    scratch.cost[STAY] = 0.0 if cell == problem.goals[i] else weight[WAIT_WEIGHT, cell] + _to_go(problem, i, cell)
    for k in range(5):
        scratch.tie[k] = draw(scratch.random)
        place = k
        while place > 0 and _before(scratch.cost, scratch.tie, k, choices[place - 1]):
            choices[place] = choices[place - 1]
            place -= 1
        choices[place] = k
    scratch.tried[i] = 0
    first = choices[0]
    scratch.partner[i] = NOBODY if first == STAY else _find_partner(problem, cells, scratch, i, leads_to[first, cell])
    if scratch.partner[i] != NOBODY:
        last = _degree(leads_to, cell)  # blocked choices come after it
        for k in range((last + 1) // 2):
            choices[k], choices[last - k] = choices[last - k], choices[k]


@jit
def _before(cost: Array, tie: Array, one: int, other: int) -> bool:
    return cost[one] < cost[other] or (cost[one] == cost[other] and tie[one] < tie[other])


@jit
def _find_partner(problem: Array, cells: Array, scratch: LacamScratch, i: int, best: int) -> int:
    """Return the agent that agent i, who would rather go to the cell `best`, must change places with; -1: nobody."""
    leads_to, occupant, cell = problem.leads_to, scratch.occupant, cells[i]
    ahead = occupant[best]
    if (
        ahead != NOBODY
        and scratch.want[ahead] == UNDECIDED
        and _must_change_places(problem, occupant, i, ahead, cell, best)
        and _has_room(leads_to, problem.goals, occupant, best, cell)
    ):
        return ahead
    for towards in range(4):
        beside = leads_to[towards, cell]
        behind = occupant[beside]
        if (
            beside != cell
            and beside != best
            and behind != NOBODY
            and _must_change_places(problem, occupant, behind, i, cell, best)
            and _has_room(leads_to, problem.goals, occupant, best, cell)
        ):
            return behind
    return NOBODY


@jit
def _must_change_places(problem: Array, occupant: Array, pusher: int, puller: int, back: int, front: int) -> bool:
    """Tell whether a pusher on `back` and a puller on `front` get in each other's way all along the corridor ahead."""
    while _to_go(problem, pusher, front) < _to_go(problem, pusher, back):
        exits, onward = _exits(problem.leads_to, problem.goals, occupant, back, front)
        if exits > 1:
            return False
        if exits == 0:
            break
        back, front = front, onward
    yields = _to_go(problem, puller, back) < _to_go(problem, puller, front)
    wants = _to_go(problem, pusher, back) == 0 or _to_go(problem, pusher, front) < _to_go(problem, pusher, back)
    return yields and wants


@jit
def _has_room(leads_to: Array, goals: Array, occupant: Array, back: int, front: int) -> bool:
    """Tell whether two agents that go from `back` to `front` and on come to a cell with two further exits."""
    entry = back
    while front != entry:
        exits, onward = _exits(leads_to, goals, occupant, back, front)
        if exits != 1:
            return exits > 1
        back, front = front, onward
    return False


@jit
def _exits(leads_to: Array, goals: Array, occupant: Array, back: int, front: int) -> tuple[int, int]:
    """Return how many ways lead on from `front` other than `back`, and the last of these; dead ends in use are none."""
    exits, onward = 0, front
    for towards in range(4):
        cell = leads_to[towards, front]
        if cell in (front, back):
            continue
        rests = occupant[cell] != NOBODY and goals[occupant[cell]] == cell
        if rests and _degree(leads_to, cell) == 1:
            continue
        exits += 1
        onward = cell
    return exits, onward


@jit
def _degree(leads_to: Array, cell: int) -> int:
    degree = 0
    for towards in range(4):
        degree += leads_to[towards, cell] != cell
    return degree


@jit
def _to_go(problem: Array, agent: int, cell: int) -> float:
    return problem.to_go[problem.table[agent], cell, 0]
