"""Safe-interval path planning: the earliest arrival of one agent among the reserved paths of others.

Phillips and Likhachev, *SIPP: Safe Interval Path Planning for Dynamic Environments*, ICRA 2011. A state is a safe
interval of a cell, with a heading. Only the earliest arrival in a state matters, because an agent that is early can
wait. Rotating agents have `D = 4` headings, cardinal agents `D = 1`. Following another agent and cycles are allowed,
swaps are not.

A* expands states in the order of their earliest possible arrival at the goal. Weights of a guidance graph are not
durations, so this order ignores them. They only break ties between moves with equally early arrivals, greedily: the
lowest sum of the move's cost and the cost to go comes first. So the path is one with the earliest arrival, but not
always the cheapest of these.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapf_pz._internal.jit import Array, jit, numba_config
from mapf_pz.planners.sipp.reservations import (
    FOREVER,
    NONE,
    Reservations,
    discard,
    last_step,
    last_visit,
    new_visit,
    safe_until,
)
from mapf_pz.simulator.kernels.cost_lookup import cost_at, num_headings, unpack_steps
from mapf_pz.simulator.kernels.state import WAIT_WEIGHT, CostToGo


class SippProblem(NamedTuple):
    """A one-shot problem of N agents on a map of C cells."""

    leads_to: Array  # (4, C + 1) int32: the cell that a move in each direction leads to; the same cell if blocked
    weight: Array  # (5, C + 1) float32: cost of moving in each direction, and of waiting or turning
    to_go: CostToGo
    steps: Array  # (S, C + 1) uint32: number of steps to go, packed as in `CostToGo`
    table: Array  # (N,) int32: index of the table for each agent's goal
    starts: Array  # (N,) int32: cells
    headings: Array  # (N,) int32: at the start; 0 for cardinal agents
    goals: Array  # (N,) int32: cells
    weighted: bool  # whether any weight differs from 1
    disappear: bool  # as in `Problem`


STATE = np.dtype(
    [
        ("seen", np.int32),  # the number of the last search that reached it
        ("reached", np.int32),  # the earliest step after which the agent can be there
        ("parent", np.int32),  # the previous state; -1: none
        ("above", np.int32),  # its neighbors in the stack of states to expand; -1: none
        ("below", np.int32),
        ("stacked", np.bool_),  # whether it is in a stack
    ],
    align=True,
)


class SippScratch(NamedTuple):
    """Scratch for V visits; state `visit * D + heading` is in the safe interval that follows the visit."""

    states: Array  # (V * D,) STATE
    top: Array  # (H,) int32: the topmost state of the stack for each arrival at the goal; -1: empty
    choices: Array  # (4,) int8: moves, in the order in which they are stacked
    cost: Array  # (4,) float32: cost of each move plus the cost to go
    count: Array  # (2,) int64: number of searches, and of expanded states


def allocate_scratch(num_visits: int, num_headings: int, horizon: int) -> SippScratch:
    """Allocate scratch for searches among V visits, for arrivals before step `horizon`."""
    states = np.zeros(num_visits * num_headings, STATE)
    return SippScratch(
        # Compiled kernels read fields as attributes; plain Python needs a record array for that.
        states=states.view(np.recarray) if numba_config.DISABLE_JIT else states,
        top=np.full(horizon, NONE, np.int32),
        choices=np.zeros(4, np.int8),
        cost=np.zeros(4, np.float32),
        count=np.zeros(2, np.int64),
    )


@jit
def find_path(
    problem: SippProblem, agent: int, limit: int, rotation: int, reservations: Reservations, scratch: SippScratch
) -> int:
    """Return the first visit of a path of `agent` with the earliest arrival, which is at most `limit`.

    The path is not reserved yet; -1: no path, or too few visits are left. `rotation` (0 to 3) is tried first, in ties.
    """
    visits, near, states, top = reservations.visits, reservations.near, scratch.states, scratch.top
    leads_to, weight, choices, cost = problem.leads_to, problem.weight, scratch.choices, scratch.cost
    table, steps, headings = problem.table[agent], problem.steps[problem.table[agent]], num_headings(problem.to_go)
    goal, start, heading = problem.goals[agent], problem.starts[agent], problem.headings[agent] % headings
    # Arrivals before `opens` are of no use, so they all count as `opens` in the order of expansion.
    opens = _first_end(problem, goal, reservations)
    limit = min(limit, top.size - 1)
    shortest = unpack_steps(steps[start], heading)
    # Bounds that need no search: when the goal becomes free for good, and the way without other agents.
    if opens > limit or shortest > limit or cost_at(problem.to_go, table, start, heading) == np.inf:
        return NONE
    scratch.count[0] += 1
    number, expanded = scratch.count[0], 0
    for k in range(4):  # assigning an array to a slice takes long to compile
        choices[k] = (rotation + k) % 4
    # Arrivals are small integers: a stack for each of them replaces a heap. The last state on a stack is expanded
    # first, which leads straight to the goal where nothing is in the way.
    lowest = highest = arrival = max(opens, shortest)
    # Visit `start` is the sentinel of the start cell: no other agent is there at first.
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
        # At the goal, the safe interval must last as long as the agent stays. An earlier interval is only passed
        # through.
        if cell == goal and until >= last_step(states[state].reached, problem.disappear):
            found = state
            break
        expanded += 1
        if problem.weighted:
            _rank(leads_to, weight, problem.to_go, table, cell, heading, choices, cost)
        for choice in choices:
            target, facing = _led_to(leads_to, headings, cell, heading, choice)
            left = unpack_steps(steps[target], facing)
            # A turn stays within the safe interval. A blocked move leads nowhere.
            if target == cell:
                if facing != heading and step <= until and max(opens, step + left) <= limit:
                    highest = max(highest, max(opens, step + left))
                    _stack(states, top, number, visit * headings + facing, state, step, left, opens)
                continue
            # The successors of Phillips and Likhachev: each safe interval of the target that begins before the present
            # one ends, at the earliest arrival in it. Waiting is implied and needs no state.
            following = last_visit(visits, near, target, step)
            while following != NONE:
                begin = max(step, visits[following].end + 1)
                # Later intervals begin even later, so none of them can be reached either.
                if begin > until + 1 or max(opens, begin + left) > limit:
                    break
                # An agent that leaves the target for this agent's cell in the same step swaps with it.
                leaves_too = begin == until + 1 and visits[following].end == until
                swaps = leaves_too and visits[following].agent == visits[visits[visit].after].agent
                if begin <= safe_until(visits, following) and not swaps:
                    highest = max(highest, max(opens, begin + left))
                    _stack(states, top, number, following * headings + facing, state, begin, left, opens)
                following = visits[following].after
    # The states themselves need not be cleared, as they have the number of their search.
    top[lowest : highest + 1] = NONE
    scratch.count[1] += expanded
    return NONE if found == NONE else _trace(agent, found, headings, problem.disappear, reservations, states)


@jit
def _first_end(problem: SippProblem, goal: int, reservations: Reservations) -> int:
    """Return the first step in which an agent can end at its goal.

    An agent that stays must come after all other visits to the goal; one that disappears may come at any time.
    """
    if problem.disappear:
        return 0
    return reservations.visits[last_visit(reservations.visits, reservations.near, goal, FOREVER)].end + 1


@jit
def _led_to(leads_to: Array, headings: int, cell: int, heading: int, choice: int) -> tuple[int, int]:
    """Return the cell and heading after a move: a direction, or for rotating agents a number of quarter turns."""
    if headings == 1:
        return leads_to[choice, cell], 0
    if choice == 0:
        return leads_to[heading, cell], heading
    return cell, heading if choice == 2 else (heading + choice) % 4


@jit
def _rank(
    leads_to: Array, weight: Array, to_go: CostToGo, table: int, cell: int, heading: int, choices: Array, cost: Array
) -> None:
    """Sort the moves by descending cost, so that the cheapest is stacked last and expanded first."""
    for choice in range(4):
        target, facing = _led_to(leads_to, num_headings(to_go), cell, heading, choice)
        leaving = choice if num_headings(to_go) == 1 else heading
        step_cost = weight[WAIT_WEIGHT if target == cell else leaving, cell]
        cost[choice] = step_cost + cost_at(to_go, table, target, facing)
        position = choice
        while position > 0 and cost[choices[position - 1]] < cost[choice]:
            choices[position] = choices[position - 1]
            position -= 1
        choices[position] = choice


@jit
def _stack(states: Array, top: Array, number: int, state: int, parent: int, step: int, left: int, opens: int) -> None:
    """Push `state` onto its stack if search `number` reaches it for the first time, or earlier than before."""
    it = states[state]
    if it.seen == number:
        # An earlier arrival in the same safe interval dominates: the agent can wait.
        if it.reached <= step:
            return
        # Before `opens`, states are not expanded in the order in which they are reached, so that even an expanded state
        # may be reached again, earlier.
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
def _trace(
    agent: int, last: int, headings: int, disappear: bool, reservations: Reservations, states: Array
) -> int:  # fmt: skip
    """Return the first of the linked visits that lead to state `last`, or -1 if too few visits are left."""
    state, end, following = last, last_step(states[last].reached, disappear), NONE
    while state != NONE:
        # All turns on a cell belong to one visit, which starts with the first of them.
        parent = states[state].parent
        if parent == NONE or parent // headings != state // headings:
            if reservations.num_spare[0] == 0:
                discard(reservations, following)
                return NONE
            cell = reservations.visits[state // headings].cell
            following = new_visit(reservations, agent, cell, states[state].reached, end, following)
            end = states[state].reached - 1
        state = parent
    return following
