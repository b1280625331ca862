"""From the configurations that LaCAM passes through to a path that carries them out, without needless steps.

Agents keep the order in which they pass each cell, and otherwise turn and drive as early as they can: whoever is to
enter a cell drives once the one before it has left, or leaves in the same step. It never gets stuck, as they could also
go through the configurations one by one (Ma et al., *Overview: Generalizations of Multi-Agent Path Finding to
Real-World Scenarios*, 2017, and *Multi-Agent Path Finding with Kinematic Constraints*, ICAPS 2016).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapf_pz.core.jit import jit
from mapf_pz.core.state import Array

NONE = -1
_HOLDS, _DRIVES, _READY, _ASKED = range(4)


class Visits(NamedTuple):
    """Which cells N agents visit, V visits in all: those of the first agent, those of the second, and so on."""

    begin: Array  # (N + 1,) int32: the first visit of each agent, that to its start
    agent: Array  # (V,) int32
    cell: Array  # (V,) int32
    towards: Array  # (V,) int8: the direction in which the agent comes
    before: Array  # (V,) int32: the visit to the same cell that must end first; -1: none


def allocate_visits(cells: Array) -> Visits:
    """Make room for the visits of N agents that go through `cells` (T + 1, N)."""
    count = int((cells[1:] != cells[:-1]).sum()) + cells.shape[1]
    return Visits(
        begin=np.zeros(cells.shape[1] + 1, np.int32),
        agent=np.zeros(count, np.int32),
        cell=np.zeros(count, np.int32),
        towards=np.zeros(count, np.int8),
        before=np.zeros(count, np.int32),
    )


@jit
def cut_loops(cells: Array, last_agent: Array, last_step: Array) -> bool:
    """Let agents stay that return to a cell which nobody else has entered meanwhile; return whether there were any.

    `cells` (T + 1, N) int32 is changed in place; `last_agent` and `last_step` (C + 1,) int32 are scratch.
    """
    found = False
    last_agent[:] = NONE
    for step in range(cells.shape[0]):
        for i in range(cells.shape[1]):
            cell = cells[step, i]
            since = last_step[cell]
            # A visit that was itself within a loop counts no more.
            if last_agent[cell] == i and since < step - 1 and cells[since, i] == cell:
                cells[since:step, i] = cell
                found = True
            last_agent[cell], last_step[cell] = i, step
    return found


@jit
def list_visits(cells: Array, leads_to: Array, visits: Visits, at: Array, last: Array) -> None:
    """Fill `visits` from `cells` (T + 1, N); `at` (N,) and `last` (C + 1,) int32 are scratch."""
    begin = visits.begin
    begin[0] = 0
    last[:] = NONE
    for i in range(at.size):
        begin[i + 1] = begin[i] + 1
        for step in range(1, cells.shape[0]):
            begin[i + 1] += cells[step, i] != cells[step - 1, i]
        at[i] = begin[i]
        last[cells[0, i]] = begin[i]
        visits.agent[begin[i] : begin[i + 1]] = i
        visits.cell[begin[i]] = cells[0, i]
    for step in range(1, cells.shape[0]):
        for i in range(at.size):
            origin, cell = cells[step - 1, i], cells[step, i]
            if origin == cell:
                continue
            at[i] += 1
            visits.cell[at[i]] = cell
            visits.before[at[i]] = last[cell]
            last[cell] = at[i]
            for towards in range(4):
                if leads_to[towards, origin] == cell:
                    visits.towards[at[i]] = towards


@jit
def carry_out(visits: Visits, rotates: bool, cells: Array, headings: Array, at: Array, intent: Array) -> int:
    """Write the path, and return how many steps it has.

    Args:
        visits: of N agents.
        rotates: whether agents turn before they drive; a turn takes a step.
        cells: (T + 1, N) int32, the first row of which is the start; T must suffice, as three steps do for each of
            those that the visits were listed from (one where agents need not turn).
        headings: (T + 1, N) int8, the same.
        at: (N,) int32, scratch.
        intent: (N,) int8, scratch.
    """
    at[:] = visits.begin[:-1]
    step, moves_left = 0, visits.cell.size - at.size
    while moves_left > 0:
        for i in range(at.size):
            turned = _turned(visits, headings[step, i], at[i], i) if rotates else headings[step, i]
            headings[step + 1, i] = turned
            ready = at[i] + 1 < visits.begin[i + 1] and turned == headings[step, i]
            intent[i] = _READY if ready else _HOLDS
        for i in range(at.size):
            if intent[i] == _READY:
                _ask_ahead(visits, at, intent, i)
        for i in range(at.size):
            if intent[i] == _DRIVES:
                at[i] += 1
                moves_left -= 1
            cells[step + 1, i] = visits.cell[at[i]]
        step += 1
    return step


@jit
def _turned(visits: Visits, heading: int, visit: int, agent: int) -> int:
    """Return where an agent looks after a step in which it does not drive, on its way to its next visit."""
    if visit + 1 == visits.begin[agent + 1]:
        return heading
    turn = (visits.towards[visit + 1] - heading) % 4
    return heading if turn == 0 else (heading + (3 if turn == 3 else 1)) % 4


@jit
def _ask_ahead(visits: Visits, at: Array, intent: Array, first: int) -> None:
    """Settle who drives of the queue from `first` on: all that are ready, if the one at its head does."""
    i = first
    verdict = _READY
    while verdict == _READY:
        intent[i] = _ASKED
        before = visits.before[at[i] + 1]
        i = visits.agent[before]  # without meaning if there is no visit before
        if before == NONE or at[i] > before:
            verdict = _DRIVES
        elif at[i] < before or intent[i] == _HOLDS:
            verdict = _HOLDS
        elif intent[i] != _READY:
            verdict = _DRIVES  # also if it was asked: then the queue is a cycle
    i = first
    while intent[i] == _ASKED:
        intent[i] = verdict
        i = visits.agent[visits.before[at[i] + 1]]
