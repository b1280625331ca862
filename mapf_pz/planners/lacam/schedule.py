"""Schedule the configurations that LaCAM found as paths without unnecessary steps.

Agents keep the order in which they pass each cell, and otherwise turn and move as early as possible: an agent enters a
cell once the agent before it has left, or when it leaves in the same step. This never deadlocks, because the agents
could also execute the configurations one at a time (Ma et al., *Overview: Generalizations of Multi-Agent Path Finding
to Real-World Scenarios*, 2017, and *Multi-Agent Path Finding with Kinematic Constraints*, ICAPS 2016).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapf_pz._internal.jit import Array, jit
from mapf_pz.planners.copying import copy_row

NONE = -1
_STAYS, _MOVES, _READY, _PENDING = range(4)


class Visits(NamedTuple):
    """The cells that N agents visit, V visits in total, grouped by agent and in order of time."""

    first: Array  # (N + 1,) int32: the first visit of each agent, which is to its start
    agent: Array  # (V,) int32
    cell: Array  # (V,) int32
    direction: Array  # (V,) int8: the direction of the move to the cell
    before: Array  # (V,) int32: the previous visit to the same cell, which must end first; -1: none


def allocate_visits(cells: Array) -> Visits:
    """Allocate the visits of N agents on the paths `cells` (T + 1, N)."""
    count = int((cells[1:] != cells[:-1]).sum()) + cells.shape[1]
    return Visits(
        first=np.zeros(cells.shape[1] + 1, np.int32),
        agent=np.zeros(count, np.int32),
        cell=np.zeros(count, np.int32),
        direction=np.zeros(count, np.int8),
        before=np.zeros(count, np.int32),
    )


@jit
def cut_loops(cells: Array, last_agent: Array, last_step: Array) -> bool:
    """Remove loops: an agent stays on a cell that it returns to before any other agent enters it.

    Returns whether there were any loops. `cells` (T + 1, N) int32 is modified in place; `last_agent` and `last_step`
    (C + 1,) int32 are scratch.
    """
    found = False
    last_agent[:] = NONE
    for step in range(cells.shape[0]):
        for i in range(cells.shape[1]):
            cell = cells[step, i]
            since = last_step[cell]
            # Ignore visits that were themselves removed with a loop.
            # No other agent was on the cell in between, so the way that led back to it was in vain.
            if last_agent[cell] == i and since < step - 1 and cells[since, i] == cell:
                cells[since:step, i] = cell
                found = True
            last_agent[cell], last_step[cell] = i, step
    return found


@jit
def list_visits(cells: Array, leads_to: Array, visits: Visits, at: Array, last: Array) -> None:
    """Fill `visits` from `cells` (T + 1, N); `at` (N,) and `last` (C + 1,) int32 are scratch."""
    first = visits.first
    first[0] = 0
    last[:] = NONE
    for i in range(at.size):
        first[i + 1] = first[i] + 1
        for step in range(1, cells.shape[0]):
            first[i + 1] += cells[step, i] != cells[step - 1, i]
        at[i] = first[i]
        last[cells[0, i]] = first[i]
        visits.agent[first[i] : first[i + 1]] = i
        visits.cell[first[i]] = cells[0, i]
    for step in range(1, cells.shape[0]):
        for i in range(at.size):
            # In order of time, so that the previous visit to each cell is known. These precedences are all that a
            # schedule must keep.
            origin, cell = cells[step - 1, i], cells[step, i]
            if origin == cell:
                continue
            at[i] += 1
            visits.cell[at[i]] = cell
            visits.before[at[i]] = last[cell]
            last[cell] = at[i]
            for direction in range(4):
                if leads_to[direction, origin] == cell:
                    visits.direction[at[i]] = direction


@jit
def schedule(
    visits: Visits, rotates: bool, disappear: bool, cells: Array, headings: Array, at: Array, intent: Array
) -> int:
    """Write the paths, and return their number of steps.

    Args:
        visits: the visits of N agents.
        rotates: whether agents must turn before they move; a turn takes a step.
        disappear: whether agents leave the map after the step of their last visit, the first step at the earliest.
        cells: (T + 1, N) int32, the first row of which holds the starts. T must be large enough: three times the number
            of steps that the visits were listed from is sufficient (one time if agents need not turn).
        headings: (T + 1, N) int8, likewise.
        at: (N,) int32, scratch.
        intent: (N,) int8, scratch.
    """
    copy_row(visits.first[:-1], at)
    step, moves_left = 0, visits.cell.size - at.size
    # In each step: who wants to move, who of them can, and the moves. Who can move depends on whether others do.
    while moves_left > 0:
        for i in range(at.size):
            turned = _turned(visits, headings[step, i], at[i]) if rotates else headings[step, i]
            headings[step + 1, i] = turned
            ready = not _is_last(visits, at[i]) and turned == headings[step, i]
            intent[i] = _READY if ready else _STAYS
        for i in range(at.size):
            if intent[i] == _READY:
                _resolve_queue(visits, disappear and step > 0, at, intent, i)
        for i in range(at.size):
            if intent[i] == _MOVES:
                at[i] += 1
                moves_left -= 1
            cells[step + 1, i] = visits.cell[at[i]]
        step += 1
    return step


@jit
def _turned(visits: Visits, heading: int, visit: int) -> int:
    """Return an agent's heading after a step in which it does not move, but turns for its next visit."""
    if _is_last(visits, visit):
        return heading
    turn = (visits.direction[visit + 1] - heading) % 4
    return heading if turn == 0 else (heading + (3 if turn == 3 else 1)) % 4


@jit
def _is_last(visits: Visits, visit: int) -> bool:
    return visit + 1 == visits.first[visits.agent[visit] + 1]


@jit
def _resolve_queue(visits: Visits, disappeared: bool, at: Array, intent: Array, first: int) -> None:
    """Decide whether the agents of the queue that starts with `first` move: all do if the one at its head can.

    With `disappeared`, agents that are on their last visits do not occupy their cells any more.
    """
    i = first
    # Along the queue, each agent waits for the one ahead to leave. Its head decides for all of them, in time
    # proportional to its length.
    decision = _READY
    while decision == _READY:
        intent[i] = _PENDING
        before = visits.before[at[i] + 1]
        i = visits.agent[before]  # meaningless if there is no previous visit
        if before == NONE or at[i] > before or (disappeared and at[i] == before and _is_last(visits, before)):
            decision = _MOVES
        elif at[i] < before or intent[i] == _STAYS:
            decision = _STAYS
        elif intent[i] != _READY:
            decision = _MOVES  # includes _PENDING: then the queue is a cycle
    i = first
    while intent[i] == _PENDING:
        intent[i] = decision
        i = visits.agent[visits.before[at[i] + 1]]
