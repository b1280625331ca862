"""The reservation table: visits of agents to cells, in linked lists that are fast to search and to change.

A visit is an agent's stay on a cell, from the first to the last step after which it is there. Every cell has a list of
its visits in order of time. The time between a visit and the next one is a safe interval of the cell, so the number of
a visit also identifies the safe interval that follows it. Visit `c < C + 1` is a sentinel without an agent, for the
time before the start on cell `c`. Agents stay on the cells of their last visits forever,
or until the end of the step in which they arrive.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapf_pz._internal.jit import Array, jit, numba_config

NONE = -1
FOREVER = 2**30


VISIT = np.dtype(
    [
        ("cell", np.int32),
        ("agent", np.int32),
        ("begin", np.int32),  # the first step after which the agent is there
        ("end", np.int32),  # the last such step, or `FOREVER`
        ("before", np.int32),  # the previous visit to the same cell; -1: none
        ("after", np.int32),  # the next visit to the same cell; -1: none
        ("next", np.int32),  # the same agent's next visit; -1: none
    ],
    align=True,
)


class Reservations(NamedTuple):
    """The paths of N agents on C cells, as at most V visits."""

    visits: Array  # (V,) VISIT
    near: Array  # (C + 1,) int32: the visit where the last search of each cell's list ended
    spare: Array  # (V,) int32: the first `num_spare` are unused visits
    num_spare: Array  # (1,) int32
    first: Array  # (N,) int32: each agent's first visit; -1: it has no path
    arrival: Array  # (N,) int32: the first step of the agent's last visit, if it has a path


def allocate_reservations(num_agents: int, num_cells: int, num_visits: int) -> Reservations:
    """Allocate `num_visits` visits for the paths of N agents on C cells, without any paths."""
    size = num_cells + 1 + num_visits
    visits = np.zeros(size, VISIT)
    visits["cell"] = np.arange(size)
    for name in ("agent", "begin", "end", "before", "after", "next"):
        visits[name] = -1
    spare = np.zeros(size, np.int32)
    spare[:num_visits] = np.arange(size - 1, num_cells, -1)
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
    """Return the last visit to `cell` that begins at `step` or before; it may have ended by then."""
    # Consecutive searches of a cell are mostly for similar times, so each starts where the last one ended.
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
def new_visit(reservations: Reservations, agent: int, cell: int, begin: int, end: int, following: int) -> int:
    """Fill in an unused visit; there must be one."""
    reservations.num_spare[0] -= 1
    # The spare visits are a stack, so memory is used again without a search for it.
    number = reservations.spare[reservations.num_spare[0]]
    visit = reservations.visits[number]
    visit.cell = cell
    visit.agent = agent
    visit.begin = begin
    visit.end = end
    visit.next = following
    return number


@jit
def reserve(reservations: Reservations, agent: int, first: int) -> None:
    """Insert the path that starts with visit `first` into the lists of its cells, as the path of `agent`."""
    visits = reservations.visits
    reservations.first[agent] = first
    visit = first
    while visit != NONE:
        # The path has no collisions, so the visit fits between two others. The sentinel of the cell precedes all of
        # them.
        previous = last_visit(visits, reservations.near, visits[visit].cell, visits[visit].begin)
        following = visits[previous].after
        visits[visit].before = previous
        visits[visit].after = following
        visits[previous].after = visit
        if following != NONE:
            visits[following].before = visit
        reservations.arrival[agent] = visits[visit].begin
        visit = visits[visit].next


@jit
def withdraw(reservations: Reservations, agent: int) -> int:
    """Remove an agent's path from the lists; return its first visit, with which it can be reserved again."""
    visits, near = reservations.visits, reservations.near
    first = visit = reservations.first[agent]
    while visit != NONE:
        previous, following = visits[visit].before, visits[visit].after
        visits[previous].after = following
        if following != NONE:
            visits[following].before = previous
        # `near` must not name a visit that is in no list.
        if near[visits[visit].cell] == visit:
            near[visits[visit].cell] = previous
        visit = visits[visit].next
    reservations.first[agent] = NONE
    return first


@jit
def discard(reservations: Reservations, first: int) -> None:
    """Free the visits of a path that is not in the lists."""
    visit = first
    while visit != NONE:
        reservations.spare[reservations.num_spare[0]] = visit
        reservations.num_spare[0] += 1
        visit = reservations.visits[visit].next


@jit
def last_step(arrival: int, disappear: bool) -> int:
    """Return the last step of a visit to the goal: an agent that disappears does so after a step at its goal."""
    return max(arrival, 1) if disappear else FOREVER


@jit
def read_path(reservations: Reservations, cells: Array, disappear: bool) -> None:
    """Reserve the paths of all agents: `cells` (T + 1, N) int32, with agents that disappear on their goals."""
    for agent in range(cells.shape[1]):
        # From the end to the start, as each visit names the next one.
        end, step, following = FOREVER, cells.shape[0] - 1, NONE
        while step >= 0:
            cell = cells[step, agent]
            while step > 0 and cells[step - 1, agent] == cell:
                step -= 1
            if following == NONE:
                end = last_step(step, disappear)
            following = new_visit(reservations, agent, cell, step, end, following)
            end = step - 1
            step -= 1
        reserve(reservations, agent, following)


@jit
def direction_after(visits: Array, leads_to: Array, visit: int, heading: int) -> int:
    """Return the direction in which an agent leaves after a visit, or `heading` if it never leaves."""
    here, following = visits[visit].cell, visits[visit].next
    for d in range(4):
        if following != NONE and leads_to[d, here] == visits[following].cell:
            return d
    return heading


@jit
def write_path(reservations: Reservations, leads_to: Array, starts: Array, cells: Array, headings: Array) -> None:
    """Write the paths of all agents to `cells` (T + 1, N) int32, with agents that disappear on their goals.

    With `headings` (T + 1, N) int8, agents have the headings `starts` (N,) at first and turn as early as possible.
    """
    visits = reservations.visits
    for agent in range(cells.shape[1]):
        visit, heading = reservations.first[agent], starts[agent]
        while visit != NONE:
            leaving = direction_after(visits, leads_to, visit, heading)
            end = cells.shape[0] if visits[visit].next == NONE else min(visits[visit].end + 1, cells.shape[0])
            for step in range(visits[visit].begin, end):
                cells[step, agent] = visits[visit].cell
                if headings.size > 0:
                    headings[step, agent] = heading
                    # A step turns by a quarter: to the left if that is enough, otherwise to the right.
                    turn = (leaving - heading) % 4
                    heading = (heading + (3 if turn == 3 else min(turn, 1))) % 4
            heading = leaving
            visit = visits[visit].next
