"""The shortest paths of one agent under constraints, by dynamic programming over its states after each step.

A state is `cell * D + heading`, with D = 4 headings, or D = 1 for cardinal agents. Of all shortest paths, the one with
the fewest conflicts with the other agents' paths is returned. The number of cells that shortest paths can be on after
each step (the width of the multi-value decision diagram) tells which conflicts raise the cost: Boyarski et al., *ICBS:
Improved Conflict-Based Search Algorithm for Multi-Agent Pathfinding*, IJCAI 2015.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapf_pz._internal.arrays import Ints
from mapf_pz._internal.jit import Array, inlined, jit

NO_PATH, FULL = -1, -2
"""Results of `search`: there is no path, or the rows of `Layers` are not enough."""
ANY = -1
"""In place of the first cell of a constraint on a cell, which forbids to be on it."""
UNREACHED = 2**30


class Agent(NamedTuple):
    """An agent's task on a map of C cells."""

    moves: Array  # (4, C) int32: the cell that a move in each direction leads to; the same cell if blocked
    num_headings: int  # D
    start: int  # state
    goal: int  # cell


class Others(NamedTuple):
    """The paths of the other agents, whose conflicts are to be avoided. After the last step, nothing changes."""

    cells: Array  # (L, N) int32: the cell of each agent after each step
    at: Array  # (L, C) int32: an agent that is on each cell after each step; -1: none


class Layers(NamedTuple):
    """The states after up to K - 1 steps."""

    conflicts: Array  # (K, C * D) int32: fewest conflicts on the way to each state; UNREACHED: not reached
    before: Array  # (K, C * D) int32: the state before on that way
    useful: Array  # (K, C * D) bool: whether a shortest path to the goal is in this state


def allocate_layers(rows: int, num_states: int) -> Layers:
    """Allocate layers."""
    shape = rows, num_states
    return Layers(np.empty(shape, np.int32), np.empty(shape, np.int32), np.empty(shape, np.bool_))


def last_on_goal(constraints: Ints, goal: int, disappear: bool) -> int:
    """Return the last step after which a constraint forbids an agent that has ended to be on its goal; 0: none.

    An agent that disappears is on its goal for as long as its path takes, which is checked step by step. Only if it
    starts there and stays, it is also there after step 1.

    Args:
        constraints: (K, 3) int32, as in `search`.
        goal: cell.
        disappear: as in `Problem`.
    """
    on_goal = (constraints[:, 1] == ANY) & (constraints[:, 2] == goal)
    if disappear:
        on_goal &= constraints[:, 0] <= 1
    return int(constraints[on_goal, 0].max(initial=0))


@inlined
def next_state(moves: Array, num_headings: int, state: int, action: int) -> int:
    """Return the state after an action: 0 waits; the others turn or move, and wait where that is not possible."""
    if action == 0:
        return state
    if num_headings == 1:
        return moves[action - 1, state]
    heading = state % 4
    if action == 1:
        return 4 * moves[heading, state // 4] + heading
    return state - heading + (heading + (1 if action == 2 else 3)) % 4


@inlined
def is_forbidden(constraints: Array, first: int, last: int, cell: int, next_cell: int) -> bool:
    """Return whether one of the constraints `first` to `last - 1` forbids a step."""
    for k in range(first, last):
        if constraints[k, 2] == next_cell and (constraints[k, 1] == ANY or constraints[k, 1] == cell):
            return True
    return False


@inlined
def _num_conflicts(others: Others, step: int, cell: int, next_cell: int) -> int:
    """Return how many conflicts a step has: 0 to 2, since at most one agent on each cell is counted."""
    rows = others.at.shape[0]
    before, after = min(step - 1, rows - 1), min(step, rows - 1)
    found = 1 if others.at[after, next_cell] >= 0 else 0
    other = others.at[before, next_cell]
    if cell != next_cell and other >= 0 and others.cells[after, other] == cell:
        found += 1
    return found


@jit
def search(agent: Agent, constraints: Array, first_end: int, others: Others, layers: Layers) -> int:
    """Return the number of steps of the shortest path that ends at the goal, or `NO_PATH` or `FULL`.

    Args:
        agent: the agent.
        constraints: (K, 3) int32, ordered by step: after `step`, the agent must not be on a cell (ANY, cell), or must
            not have moved (from, to).
        first_end: the agent must not end before this step; no later step has a constraint on its end.
        others: the other agents.
        layers: the states after each step, which are overwritten.
    """
    moves, num_headings, start, goal = agent
    num_states = layers.conflicts.shape[1]
    num_actions = 5 if num_headings == 1 else 4
    last_step = constraints[-1, 0] if len(constraints) else 0
    # All actions take a step, so layers in order of time need no heap: the first layer in which the agent may end has
    # the shortest paths. Within a layer, each state keeps the way to it with the fewest conflicts.
    layers.conflicts[0] = UNREACHED
    layers.conflicts[0, start] = 0
    first = 0
    for step in range(layers.conflicts.shape[0]):
        now = layers.conflicts[step]
        if step >= first_end:
            for heading in range(num_headings):
                if now[goal * num_headings + heading] < UNREACHED:
                    return step
        if step == layers.conflicts.shape[0] - 1:
            break
        # Agents can wait, so after the last constraint the set of states that are reached only grows. After as many
        # steps as there are states it is complete, and the goal is not among them.
        if step > last_step + num_states:  # nothing changes any more
            return NO_PATH
        after = layers.conflicts[step + 1]
        after[:] = UNREACHED
        # Constraints are in order of time: those of the next step are from `first` to `last - 1`.
        while first < len(constraints) and constraints[first, 0] <= step:
            first += 1
        last = first
        while last < len(constraints) and constraints[last, 0] == step + 1:
            last += 1
        for state in range(num_states):
            if now[state] == UNREACHED:
                continue
            cell = state // num_headings
            for action in range(num_actions):
                then = next_state(moves, num_headings, state, action)
                next_cell = then // num_headings
                if is_forbidden(constraints, first, last, cell, next_cell):
                    continue
                found = now[state] + _num_conflicts(others, step + 1, cell, next_cell)
                if found < after[then]:
                    after[then] = found
                    layers.before[step + 1, then] = state
    return FULL


@jit
def read_path(agent: Agent, constraints: Array, layers: Layers, cells: Array, headings: Array, widths: Array) -> None:
    """Write the path with the fewest conflicts, and the number of cells that shortest paths can be on.

    Args:
        agent: as in `search`.
        constraints: as in `search`.
        layers: those of `search`, which found a path of T steps.
        cells: (T + 1,) int32.
        headings: (T + 1,) int8; 0 for cardinal agents.
        widths: (T + 1,) int32.
    """
    moves, num_headings, _, goal = agent
    num_states, num_steps = layers.conflicts.shape[1], len(cells) - 1
    num_actions = 5 if num_headings == 1 else 4
    # From the end to the start, a state is useful if it was reached from the start and an action leads on to a useful
    # state of the next layer. These are the nodes of the multi-value decision diagram.
    layers.useful[: num_steps + 1] = False
    state = goal * num_headings
    for heading in range(num_headings):
        # The agent may end with any heading; the path takes the one with the fewest conflicts.
        end = goal * num_headings + heading
        layers.useful[num_steps, end] = layers.conflicts[num_steps, end] < UNREACHED
        if layers.conflicts[num_steps, end] < layers.conflicts[num_steps, state]:
            state = end
    last = len(constraints)
    for step in range(num_steps, -1, -1):
        cells[step], headings[step] = state // num_headings, state % num_headings
        if step > 0:
            state = layers.before[step, state]
        widths[step] = 0
        # Agents conflict by cells, so states that differ in the heading count once.
        for cell in range(num_states // num_headings):
            widths[step] += layers.useful[step, cell * num_headings : (cell + 1) * num_headings].any()
        while last > 0 and constraints[last - 1, 0] > step:
            last -= 1
        first = last
        while first > 0 and constraints[first - 1, 0] == step:
            first -= 1
        for before in range(num_states if step > 0 else 0):
            if layers.conflicts[step - 1, before] == UNREACHED:
                continue
            for action in range(num_actions):
                after = next_state(moves, num_headings, before, action)
                if layers.useful[step, after] and not is_forbidden(
                    constraints, first, last, before // num_headings, after // num_headings
                ):
                    layers.useful[step - 1, before] = True
