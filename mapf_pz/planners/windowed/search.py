"""A* in space and time: the cheapest path of one agent over the next T steps, among the paths of the other agents.

The cost of a path is that of its actions and the cost to go from its end. If the agent only has to pass its goal, it is
the cost until then. A collision with the path of another agent has a price, or is not allowed.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapf_pz._internal.jit import Array, jit, numba_config
from mapf_pz.planners.pibt.state import NO_AGENT
from mapf_pz.planners.windowed.paths import Paths, facing
from mapf_pz.simulator.kernels.cost_lookup import cost_at, num_headings
from mapf_pz.simulator.kernels.state import WAIT_WEIGHT, PlanningView

NONE = -1
LATE = 2.0**-10
"""Subtracted from a state's key for each step, so that of states with equal costs, the last one is expanded first."""
ROUNDING = 1e-6

STATE = np.dtype(
    [
        ("seen", np.int32),  # the number of the last search that reached it
        ("cost", np.float32),  # the lowest cost from the start, including the price of collisions
        ("parent", np.int32),  # the previous state; -1: none
        ("cell", np.int32),
    ],
    align=True,
)


class SearchScratch(NamedTuple):
    """Scratch for searches over T steps, with D = 4 headings, or 1 for cardinal agents.

    The number of a state is `(t * S * S + place) * 2 * D + 2 * heading + passed`. Its `place` is in a square of
    S = 2 * T + 1 cells around the start; `passed` tells whether the agent has passed its goal.
    """

    states: Array  # ((T + 1) * S * S * 2 * D,) STATE
    key: Array  # (K,) float64: binary heap of the keys of the states to expand
    open: Array  # (K,) int32: their numbers
    count: Array  # (1,) int64: number of searches
    cell: Array  # (T + 1,) int32: the path that was found
    heading: Array  # (T + 1,) int32


def allocate_search(window: int, num_headings: int) -> SearchScratch:
    """Allocate scratch for searches over `window` steps."""
    states = np.zeros((window + 1) * (2 * window + 1) ** 2 * num_headings * 2, STATE)
    return SearchScratch(
        # Compiled kernels read fields as attributes; plain Python needs a record array for that.
        states=states.view(np.recarray) if numba_config.DISABLE_JIT else states,
        key=np.zeros(states.size, np.float64),
        open=np.zeros(states.size, np.int32),
        count=np.zeros(1, np.int64),
        cell=np.zeros(window + 1, np.int32),
        heading=np.zeros(window + 1, np.int32),
    )


@jit
def find_path(
    planning_view: PlanningView, i: int, passing: bool, limit: float, price: float, rotation: int, paths: Paths,
    scratch: SearchScratch
) -> bool:  # fmt: skip
    """Find a path of agent `i`, whose present path is not in `paths.used`; return whether there is one.

    Args:
        planning_view: the environment.
        i: the agent.
        passing: whether the agent only has to pass its goal.
        limit: the cost, including the price of collisions, must be below it.
        price: the price of a collision with the path of an agent that is not fixed.
        rotation: the direction, 0 to 3, that comes first in ties.
        paths: the paths of the other agents.
        scratch: `cell` and `heading` receive the path.
    """
    agent, leads_to, weight = planning_view.agents[i], planning_view.leads_to, planning_view.weight
    states, key, open = scratch.states, scratch.key, scratch.open
    used, fixed, goal, last = paths.used, paths.fixed, agent.goal, paths.cell.shape[1] - 1
    to_go, table = planning_view.to_go, planning_view.slot[goal]
    headings = num_headings(to_go)
    side = 2 * last + 1
    layer, shift = side * side * 2 * headings, (1, side, -1, -side, 0)
    scratch.count[0] += 1
    # States of earlier searches have another number, so that none has to be cleared.
    number = scratch.count[0]
    # An agent that is on its goal has not passed it yet: an arrival takes a step, of which waiting is one.
    state = 2 * (headings * (side * last + last) + facing(planning_view, agent))
    states[state].seen, states[state].cost, states[state].parent = number, 0.0, NONE
    states[state].cell = agent.cell
    size = _push(key, open, 0, 0.0, state)
    while size > 0:
        state, lowest = open[0], key[0]
        size = _pop(key, open, size)
        step, within = divmod(state, layer)
        heading, passed, place = (within >> 1) & (headings - 1), within & 1, within // (2 * headings)
        here = states[state].cell
        left = np.float32(0.0) if passed else cost_at(to_go, table, here, heading)
        # A state is pushed again when it is reached at a lower cost; its older entries stay in the heap.
        if step > 0 and lowest > states[state].cost + left - LATE * step + ROUNDING:
            continue  # it has been expanded at a lower cost
        # The cost to go never overestimates, so the first path that leaves the heap is a cheapest one, up to `LATE` for
        # each step. It stands for the way beyond the window, as in WHCA* (Silver, *Cooperative Pathfinding*, AIIDE
        # 2005).
        if step == last:
            _trace(state, layer, headings, scratch)
            return True
        for k in range(5 if headings == 1 else 4):
            direction, turned = _act(headings, heading, (k + rotation) & 3 if k < 4 else 4)
            there = here if direction == WAIT_WEIGHT else leads_to[direction, here]
            # What follows a goal that is only passed is free, as the next goal is not known. An agent that must stay at
            # its goal waits there for free. Neither makes a blocked edge free.
            is_free = passed or (not passing and here == goal and direction == WAIT_WEIGHT and turned == heading)
            cost = np.float32(0.0) if is_free and weight[direction, here] < np.inf else weight[direction, here]
            cost = np.float32(
                cost + states[state].cost + _price_of_collisions(used, fixed, price, step + 1, here, there)
            )
            # Whether the goal has been passed belongs to the state: only before that does the way to it count.
            passes = passed or (passing and there == goal)
            left = np.float32(0.0) if passes else cost_at(to_go, table, there, turned)
            # This also drops moves of infinite cost. If the heap is full, a path may be missed, which callers must
            # allow for.
            if not cost + left < limit or size == open.size:
                continue
            following = (step + 1) * layer + 2 * (headings * (place + shift[direction]) + turned) + passes
            it = states[following]
            if it.seen != number or it.cost > cost:
                it.seen, it.cost, it.parent, it.cell = number, cost, state, there
                size = _push(key, open, size, cost + left - LATE * (step + 1), following)
    return False


@jit
def _act(headings: int, heading: int, choice: int) -> tuple[int, int]:
    """Return the direction of a move, or `WAIT_WEIGHT` without a move, and the heading after it.

    The choices of cardinal agents are the directions and to wait; those of others are to move, turn right, wait and
    turn left.
    """
    if headings == 1:
        return choice, 0
    # Headings follow the directions clockwise, so a turn to the right adds 1, and a turn to the left 3.
    return heading if choice == 0 else WAIT_WEIGHT, heading if choice == 2 else (heading + choice) & 3


@jit
def _price_of_collisions(used: Array, fixed: Array, price: float, t: int, here: int, there: int) -> float:
    """Return the price of the collisions of a move from `here` to `there` in step `t`; infinity with fixed agents."""
    # In a swap, the agent that was on `there` is on `here` afterward. A cycle of three or more agents is no collision.
    total, there_after, there_before = 0.0, used[t, there], used[t - 1, there]
    if there_after != NO_AGENT:
        total += np.inf if fixed[there_after] else price
    if there_before != NO_AGENT and here != there and used[t, here] == there_before:  # a swap
        total += np.inf if fixed[there_before] else price
    return total


@jit
def _trace(state: int, layer: int, headings: int, scratch: SearchScratch) -> None:
    """Write the path that ends with a state; a step has `layer` states."""
    while state != NONE:
        step = state // layer
        scratch.cell[step] = scratch.states[state].cell
        scratch.heading[step] = (state >> 1) & (headings - 1)
        state = scratch.states[state].parent


@jit
def _push(key: Array, open: Array, size: int, own: float, state: int) -> int:
    """Add a state with the key `own` to the heap; return the new size."""
    child = size
    while child > 0:
        parent = (child - 1) >> 1
        if key[parent] <= own:
            break
        key[child], open[child] = key[parent], open[parent]
        child = parent
    key[child], open[child] = own, state
    return size + 1


@jit
def _pop(key: Array, open: Array, size: int) -> int:
    """Remove the state with the lowest key from the heap; return the new size."""
    size -= 1
    own, state = key[size], open[size]
    parent = 0
    while True:
        child = 2 * parent + 1
        if child >= size:
            break
        if child + 1 < size and key[child + 1] < key[child]:
            child += 1
        if own <= key[child]:
            break
        key[parent], open[parent] = key[child], open[child]
        parent = child
    key[parent], open[parent] = own, state
    return size
