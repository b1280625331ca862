"""Who is where and when: the visits that agents make to cells, in lists that are quick to search and to change.

A visit is an agent's stay on a cell, from the step after which it is there to the last step after which it still is.
Every cell has a list of its visits in order of time. What lies between one visit and the next is a safe interval of the
cell, so the number of a visit is also that of the safe interval that follows it. Visit `c < C + 1` stands for all time
before the start on cell `c`; nobody makes it. Agents rest on the cells of their last visits for ever.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapf_pz.core.jit import jit, numba_config
from mapf_pz.core.state import Array

NONE = -1
FOREVER = 2**30


VISIT = np.dtype(
    [
        ("cell", np.int32),
        ("agent", np.int32),
        ("begin", np.int32),  # the step after which the agent is there
        ("end", np.int32),  # the last such step, or `FOREVER`
        ("before", np.int32),  # the visit before it to the same cell
        ("after", np.int32),  # the visit after it to the same cell; -1: none
        ("then", np.int32),  # the same agent's next visit; -1: none
    ],
    align=True,
)


class Reservations(NamedTuple):
    """The paths of N agents on C cells, with room for V visits."""

    visits: Array  # (V,) VISIT
    near: Array  # (C + 1,) int32: where the last search of each cell's list ended
    spare: Array  # (V,) int32: the first `num_spare` are visits not in use
    num_spare: Array  # (1,) int32
    first: Array  # (N,) int32: each agent's first visit; -1: it has no path
    arrival: Array  # (N,) int32: the step after which it rests for good, if it has a path


def allocate_reservations(num_agents: int, num_cells: int, num_visits: int) -> Reservations:
    """Make room for paths of N agents on C cells, `num_visits` long in all; nobody has one yet."""
    room = num_cells + 1 + num_visits
    visits = np.zeros(room, VISIT)
    visits["cell"] = np.arange(room)
    for name in ("agent", "begin", "end", "before", "after", "then"):
        visits[name] = -1
    spare = np.zeros(room, np.int32)
    spare[:num_visits] = np.arange(room - 1, num_cells, -1)
    return Reservations(
        # Compiled kernels read fields as attributes; plain Python needs a record array for that.
        visits=visits.view(np.recarray) if numba_config.DISABLE_JIT else visits,
        near=np.arange(num_cells + 1, dtype=np.int32),
        spare=spare,
        num_spare=np.array([num_visits], np.int32),
        first=np.full(num_agents, NONE, np.int32),
        arrival=np.zeros(num_agents, np.int32),
    )


@jit
def last_visit(visits: Array, near: Array, cell: int, step: int) -> int:
    """Return the last visit to `cell` that begins at `step` or before; whoever makes it may have left by then."""
    # Searches of one cell mostly ask for much the same time, so they begin where the last one ended.
    visit = near[cell]
    while visits[visit].begin > step:
        visit = visits[visit].before
    while visits[visit].after != NONE and visits[visits[visit].after].begin <= step:
        visit = visits[visit].after
    near[cell] = visit
    return visit


@jit
def safe_until(visits: Array, visit: int) -> int:
    """Return the last step of the safe interval that follows a visit."""
    following = visits[visit].after
    return FOREVER if following == NONE else visits[following].begin - 1


@jit
def new_visit(reservations: Reservations, agent: int, cell: int, begin: int, end: int, then: int) -> int:
    """Take a spare visit and fill it in; there must be one."""
    reservations.num_spare[0] -= 1
    number = reservations.spare[reservations.num_spare[0]]
    visit = reservations.visits[number]
    visit.cell = cell
    visit.agent = agent
    visit.begin = begin
    visit.end = end
    visit.then = then
    return number


@jit
def reserve(reservations: Reservations, agent: int, first: int) -> None:
    """Enter the path that begins with visit `first` into the lists of its cells, as that of `agent`."""
    visits = reservations.visits
    reservations.first[agent] = first
    visit = first
    while visit != NONE:
        previous = last_visit(visits, reservations.near, visits[visit].cell, visits[visit].begin)
        following = visits[previous].after
        visits[visit].before = previous
        visits[visit].after = following
        visits[previous].after = visit
        if following != NONE:
            visits[following].before = visit
        reservations.arrival[agent] = visits[visit].begin
        visit = visits[visit].then


@jit
def withdraw(reservations: Reservations, agent: int) -> int:
    """Take an agent's path out of the lists; return its first visit, with which it can be reserved again."""
    visits, near = reservations.visits, reservations.near
    first = visit = reservations.first[agent]
    while visit != NONE:
        previous, following = visits[visit].before, visits[visit].after
        visits[previous].after = following
        if following != NONE:
            visits[following].before = previous
        if near[visits[visit].cell] == visit:
            near[visits[visit].cell] = previous
        visit = visits[visit].then
    reservations.first[agent] = NONE
    return first


@jit
def discard(reservations: Reservations, first: int) -> None:
    """Give back the visits of a path that is not in the lists."""
    visit = first
    while visit != NONE:
        reservations.spare[reservations.num_spare[0]] = visit
        reservations.num_spare[0] += 1
        visit = reservations.visits[visit].then


@jit
def read_path(reservations: Reservations, cells: Array) -> None:
    """Reserve the paths of all agents: `cells` (T + 1, N) int32."""
    for agent in range(cells.shape[1]):
        end, step, then = FOREVER, cells.shape[0] - 1, NONE
        while step >= 0:
            cell = cells[step, agent]
            while step > 0 and cells[step - 1, agent] == cell:
                step -= 1
            then = new_visit(reservations, agent, cell, step, end, then)
            end = step - 1
            step -= 1
        reserve(reservations, agent, then)


@jit
def towards(visits: Array, leads_to: Array, visit: int, heading: int) -> int:
    """Return the direction in which an agent leaves after a visit; `heading` if it never does."""
    here, following = visits[visit].cell, visits[visit].then
    for d in range(4):
        if following != NONE and leads_to[d, here] == visits[following].cell:
            return d
    return heading


@jit
def write_path(reservations: Reservations, leads_to: Array, starts: Array, cells: Array, headings: Array) -> None:
    """Write the paths of all agents to `cells` (T + 1, N) int32.

    With `headings` (T + 1, N) int8, agents that face `starts` (N,) at first turn as soon as they can.
    """
    visits = reservations.visits
    for agent in range(cells.shape[1]):
        visit, heading = reservations.first[agent], starts[agent]
        while visit != NONE:
            leaving = towards(visits, leads_to, visit, heading)
            for step in range(visits[visit].begin, min(visits[visit].end + 1, cells.shape[0])):
                cells[step, agent] = visits[visit].cell
                if headings.size > 0:
                    headings[step, agent] = heading
                    turn = (leaving - heading) % 4
                    heading = (heading + (3 if turn == 3 else min(turn, 1))) % 4
            heading = leaving
            visit = visits[visit].then
