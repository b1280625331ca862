"""Safe-interval path planning: the earliest arrival of one agent among the reserved paths of others.

Phillips and Likhachev, *SIPP: Safe Interval Path Planning for Dynamic Environments*, ICRA 2011. A state is a safe
interval of a cell, with a heading. Of all ways into it the first one serves best, as who comes early can wait. Agents
that turn have `D = 4` headings, cardinal ones `D = 1`. Following another agent is allowed, and cycles are; changing
places is not.

A* takes the states in the order of the earliest arrival at the goal that they may lead to. Weights of a guidance graph
are no durations, so they do not count in it. They only decide between moves that may arrive equally early, greedily:
the one with the lowest cost of itself and to go comes first. So the path is not always the cheapest of the earliest.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapf_pz.core.jit import jit, numba_config
from mapf_pz.core.state import WAIT_WEIGHT, Array
from mapf_pz.planners.sipp.reservations import FOREVER, NONE, Reservations, discard, last_visit, new_visit, safe_until


class SippProblem(NamedTuple):
    """Where N agents are to go on a map of C cells."""

    leads_to: Array  # (4, C + 1) int32: the cell that a move in each direction ends in; the own cell if blocked
    weight: Array  # (5, C + 1) float32: of leaving in each direction, and of waiting or turning
    to_go: Array  # (S, C + 1, D) float32: weighted cost to go
    steps: Array  # (S, C + 1, D) float32: fewest steps to go; inf: there is no way
    table: Array  # (N,) int32: which of the tables is that of the agent's goal
    starts: Array  # (N,) int32: cells
    headings: Array  # (N,) int32: at the start; 0 for cardinal agents
    goals: Array  # (N,) int32: cells
    weighted: bool  # whether `weight` differs from 1 anywhere


STATE = np.dtype(
    [
        ("seen", np.int32),  # the number of the last search that reached it
        ("reached", np.int32),  # the first step after which the agent can be there
        ("parent", np.int32),  # the state before; -1: none
        ("above", np.int32),  # its neighbours in the stack of states to expand; -1: none
        ("below", np.int32),
        ("stacked", np.bool_),  # whether it is in that stack
    ],
    align=True,
)


class SippScratch(NamedTuple):
    """Scratch for V visits; state `visit * D + heading` is in the safe interval that follows the visit."""

    states: Array  # (V * D,) STATE
    top: Array  # (H,) int32: the topmost state of the stack for each arrival at the goal; -1: empty
    choices: Array  # (4,) int8: moves, in the order in which they are stacked
    price: Array  # (4,) float32
    count: Array  # (2,) int64: searches so far, and states expanded so far


def allocate_scratch(num_visits: int, num_headings: int, horizon: int) -> SippScratch:
    """Make room for searches among V visits in all, for arrivals before step `horizon`."""
    states = np.zeros(num_visits * num_headings, STATE)
    return SippScratch(
        # Compiled kernels read fields as attributes; plain Python needs a record array for that.
        states=states.view(np.recarray) if numba_config.DISABLE_JIT else states,
        top=np.full(horizon, NONE, np.int32),
        choices=np.zeros(4, np.int8),
        price=np.zeros(4, np.float32),
        count=np.zeros(2, np.int64),
    )


@jit
def find_path(
    task: SippProblem, agent: int, limit: int, rotation: int, reservations: Reservations, search: SippScratch
) -> int:
    """Return the first visit of a path of `agent` that arrives as early as possible, and at `limit` at the latest.

    The path is not reserved yet. Returns -1 if there is none, or too little room. Which of the directions comes first,
    `rotation` (0 to 3), decides between equally good moves.
    """
    visits, near, states, top = reservations.visits, reservations.near, search.states, search.top
    leads_to, weight, choices, price = task.leads_to, task.weight, search.choices, search.price
    steps, to_go = task.steps[task.table[agent]], task.to_go[task.table[agent]]
    headings = steps.shape[1]
    goal, start, heading = task.goals[agent], task.starts[agent], task.headings[agent] % headings
    opens = visits[last_visit(visits, near, goal, FOREVER)].end + 1  # nobody comes to the goal from then on
    limit = min(limit, top.size - 1)
    if opens > limit or to_go[start, heading] == np.inf or steps[start, heading] > limit:
        return NONE
    search.count[0] += 1
    number, expanded = search.count[0], 0
    for k in range(4):
        choices[k] = (k + rotation) % 4
    lowest = highest = arrival = max(opens, int(steps[start, heading]))
    # Visit `start` is the time before all others: nobody else is there in the beginning.
    _stack(states, top, number, start * headings + heading, NONE, 0, 0, arrival)
    found = NONE
    while arrival <= highest:
        state = top[arrival]
        if state == NONE:
            arrival += 1
            continue
        _unstack(states, top, state, arrival)
        visit, heading = divmod(state, headings)
        cell, until, step = visits[visit].cell, safe_until(visits, visit), states[state].reached + 1
        if cell == goal and until == FOREVER:
            found = state
            break
        expanded += 1
        if task.weighted:
            _rank(leads_to, weight, to_go, cell, heading, choices, price)
        for choice in choices:
            target, facing = _led_to(leads_to, headings, cell, heading, choice)
            left = int(steps[target, facing])
            if target == cell:
                if facing != heading and step <= until and max(opens, step + left) <= limit:
                    highest = max(highest, max(opens, step + left))
                    _stack(states, top, number, visit * headings + facing, state, step, left, opens)
                continue
            following = last_visit(visits, near, target, step)
            while following != NONE:
                begin = max(step, visits[following].end + 1)
                if begin > until + 1 or max(opens, begin + left) > limit:
                    break
                # Whoever leaves the target as this agent leaves its cell, to be on that cell next, changes places.
                leaves_too = begin == until + 1 and visits[following].end == until
                swaps = leaves_too and visits[following].agent == visits[visits[visit].after].agent
                if begin <= safe_until(visits, following) and not swaps:
                    highest = max(highest, max(opens, begin + left))
                    _stack(states, top, number, following * headings + facing, state, begin, left, opens)
                following = visits[following].after
    top[lowest : highest + 1] = NONE
    search.count[1] += expanded
    return NONE if found == NONE else _trace(agent, found, headings, reservations, states)


@jit
def _led_to(leads_to: Array, headings: int, cell: int, heading: int, choice: int) -> tuple[int, int]:
    """Return the cell and heading that a move leads to: a direction, or for agents that turn how much to turn."""
    if headings == 1:
        return leads_to[choice, cell], 0
    if choice == 0:
        return leads_to[heading, cell], heading
    return cell, heading if choice == 2 else (heading + choice) % 4


@jit
def _rank(leads_to: Array, weight: Array, to_go: Array, cell: int, heading: int, choices: Array, price: Array) -> None:
    """Sort the moves so that the cheapest is stacked last, which is taken up first."""
    for choice in range(4):
        target, facing = _led_to(leads_to, to_go.shape[1], cell, heading, choice)
        leaving = choice if to_go.shape[1] == 1 else heading
        price[choice] = weight[WAIT_WEIGHT if target == cell else leaving, cell] + to_go[target, facing]
        place = choice
        while place > 0 and price[choices[place - 1]] < price[choice]:
            choices[place] = choices[place - 1]
            place -= 1
        choices[place] = choice


@jit
def _stack(states: Array, top: Array, number: int, state: int, parent: int, step: int, left: int, opens: int) -> None:
    """Put `state` on its stack if this is the first way to it in search `number`, or the earliest."""
    it = states[state]
    if it.seen == number:
        if it.reached <= step:
            return
        # While nobody can rest at the goal yet, states are not taken up in the order in which they are reached, so that
        # even one that was expanded may be reached earlier yet.
        if it.stacked:
            _unstack(states, top, state, max(opens, it.reached + left))
    arrival = max(opens, step + left)
    it.seen = number
    it.reached = step
    it.parent = parent
    it.above = NONE
    it.below = top[arrival]
    it.stacked = True
    if top[arrival] != NONE:
        states[top[arrival]].above = state
    top[arrival] = state


@jit
def _unstack(states: Array, top: Array, state: int, arrival: int) -> None:
    above, below = states[state].above, states[state].below
    states[state].stacked = False
    if above == NONE:
        top[arrival] = below
    else:
        states[above].below = below
    if below != NONE:
        states[below].above = above


@jit
def _trace(agent: int, last: int, headings: int, reservations: Reservations, states: Array) -> int:
    """Return the first of the visits that lead to state `last`, linked; -1 if there are too few spare ones."""
    state, end, then = last, FOREVER, NONE
    while state != NONE:
        # Turns on a cell belong to one visit, which began with the first of them.
        parent = states[state].parent
        if parent == NONE or parent // headings != state // headings:
            if reservations.num_spare[0] == 0:
                discard(reservations, then)
                return NONE
            cell = reservations.visits[state // headings].cell
            then = new_visit(reservations, agent, cell, states[state].reached, end, then)
            end = states[state].reached - 1
        state = parent
    return then
