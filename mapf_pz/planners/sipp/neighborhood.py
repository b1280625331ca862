"""Which agents to plan anew together: the neighbourhoods of a large neighbourhood search.

Those of Li et al., *Anytime Multi-Agent Path Finding via Large Neighborhood Search*, IJCAI 2021: whoever is in the way
of an agent that arrives late; whoever passes a part of the map; and anybody. Agents without a path are a fourth case:
whoever is in the way on a shortest path.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapf_pz.core.jit import jit
from mapf_pz.core.state import Array
from mapf_pz.planners.random import draw_below, seeded
from mapf_pz.planners.sipp.reservations import FOREVER, NONE, Reservations, last_visit, towards
from mapf_pz.planners.sipp.search import SippProblem

DELAYED, PLACE, ANYBODY = range(3)
KINDS = 3


class Neighborhood(NamedTuple):
    """Some of N agents on C cells; and the state of the random numbers that choose them."""

    agents: Array  # (N,) int32: the first `size` are in the neighbourhood
    size: Array  # (1,) int64
    chosen: Array  # (N,) bool: whether each agent is
    queue: Array  # (C + 1,) int32: scratch of a breadth-first search
    seen: Array  # (C + 1,) int64: the number of the last search that met each cell
    count: Array  # (1,) int64: how many searches there were
    random: Array  # (1,) uint64, not 0


def allocate_neighborhood(num_agents: int, num_cells: int, seed: int) -> Neighborhood:
    """Make room for N agents on C cells; `seed` (not 0) begins the random numbers."""
    return Neighborhood(
        agents=np.zeros(num_agents, np.int32),
        size=np.zeros(1, np.int64),
        chosen=np.zeros(num_agents, np.bool_),
        queue=np.zeros(num_cells + 1, np.int32),
        seen=np.zeros(num_cells + 1, np.int64),
        count=np.zeros(1, np.int64),
        random=seeded(seed),
    )


@jit
def choose_neighborhood(
    kind: int, wanted: int, task: SippProblem, reservations: Reservations, neighborhood: Neighborhood
) -> None:
    """Choose at most `wanted` agents by one of the `KINDS`; sometimes nobody."""
    clear(neighborhood)
    if kind == DELAYED:
        _in_the_way_of_one_delayed(wanted, task, reservations, neighborhood)
    elif kind == PLACE:
        _passing_a_place(wanted, task, reservations, neighborhood)
    else:
        while neighborhood.size[0] < min(wanted, task.goals.size):
            add(neighborhood, draw_below(neighborhood.random, task.goals.size))


@jit
def choose_around_missing(
    wanted: int, task: SippProblem, reservations: Reservations, neighborhood: Neighborhood
) -> None:
    """Choose one of the agents that have no path, and at most `wanted` - 1 others in its way."""
    clear(neighborhood)
    agent = draw_below(neighborhood.random, task.goals.size)
    while reservations.first[agent] != NONE:
        agent = (agent + 1) % task.goals.size
    add(neighborhood, agent)
    for _ in range(10):
        _walk(agent, task.starts[agent], task.headings[agent], 0, FOREVER, wanted, task, reservations, neighborhood)


@jit
def clear(neighborhood: Neighborhood) -> None:
    """Let nobody be in the neighbourhood."""
    for k in range(neighborhood.size[0]):
        neighborhood.chosen[neighborhood.agents[k]] = False
    neighborhood.size[0] = 0


@jit
def add(neighborhood: Neighborhood, agent: int) -> None:
    """Let `agent` be in the neighbourhood."""
    if not neighborhood.chosen[agent]:
        neighborhood.chosen[agent] = True
        neighborhood.agents[neighborhood.size[0]] = agent
        neighborhood.size[0] += 1


@jit
def shuffle(neighborhood: Neighborhood) -> None:
    """Put the agents of the neighbourhood into random order."""
    agents = neighborhood.agents
    for k in range(neighborhood.size[0] - 1, 0, -1):
        other = draw_below(neighborhood.random, k + 1)
        agents[k], agents[other] = agents[other], agents[k]


@jit
def delay(task: SippProblem, reservations: Reservations, agent: int) -> int:
    """Return how many steps later than on an empty map an agent arrives; 0 if it has no path."""
    if reservations.first[agent] == NONE:
        return 0
    return reservations.arrival[agent] - shortest(task, agent)


@jit
def shortest(task: SippProblem, agent: int) -> int:
    """Return how many steps an agent needs on an empty map."""
    return int(task.steps[task.table[agent], task.starts[agent], task.headings[agent] % task.steps.shape[2]])


@jit
def _in_the_way_of_one_delayed(
    wanted: int, task: SippProblem, reservations: Reservations, neighborhood: Neighborhood
) -> None:
    """Choose an agent, the likelier the later it is, and others in the way on random walks that would be earlier."""
    visits = reservations.visits
    total = 0
    for i in range(task.goals.size):
        total += delay(task, reservations, i)
    if total == 0:
        return
    mark = draw_below(neighborhood.random, total)
    agent = 0
    while mark >= delay(task, reservations, agent):
        mark -= delay(task, reservations, agent)
        agent += 1
    add(neighborhood, agent)
    length = 0
    visit = reservations.first[agent]
    while visit != NONE:
        length += 1
        visit = visits[visit].then
    for _ in range(10):
        visit, heading = reservations.first[agent], task.headings[agent]
        for _ in range(draw_below(neighborhood.random, length)):
            heading = towards(visits, task.leads_to, visit, heading)
            visit = visits[visit].then
        cell, step, arrival = visits[visit].cell, visits[visit].begin, reservations.arrival[agent]
        _walk(agent, cell, heading, step, arrival, wanted, task, reservations, neighborhood)


@jit
def _walk(
    agent: int, cell: int, heading: int, step: int, arrival: int, wanted: int, task: SippProblem, reservations: Reservations,
    neighborhood: Neighborhood
) -> None:  # fmt: skip
    """Choose whoever is in the way on a random walk of `agent` that can still arrive before `arrival`.

    Where there is no such arrival to keep to (`FOREVER`), the walk takes a shortest way, and whoever crosses the goal
    afterwards is in the way, too.
    """
    visits, headings = reservations.visits, task.steps.shape[2]
    steps = task.steps[task.table[agent]]
    heading %= headings
    while neighborhood.size[0] < wanted and steps[cell, heading] > 0:
        left = steps[cell, heading] if arrival == FOREVER else arrival - step - 1
        target, facing, found = cell, heading, 0
        for choice in range(5):
            following, turned = cell, heading
            if headings == 1:
                following = cell if choice == 4 else task.leads_to[choice, cell]
            elif choice == 0:
                following = task.leads_to[heading, cell]
            elif choice == 1 or choice == 3:
                turned = (heading + choice) % 4
            if steps[following, turned] < left:
                found += 1
                if draw_below(neighborhood.random, found) == 0:
                    target, facing = following, turned
        if found == 0:
            return
        step += 1
        _add_whoever_collides(cell, target, step, reservations, neighborhood)
        cell, heading = target, facing
    visit = last_visit(visits, reservations.near, cell, step)
    while arrival == FOREVER and visit != NONE and neighborhood.size[0] < wanted:
        if visits[visit].end >= step:
            add(neighborhood, visits[visit].agent)
        visit = visits[visit].after


@jit
def _add_whoever_collides(
    cell: int, target: int, step: int, reservations: Reservations, neighborhood: Neighborhood
) -> None:
    """Choose who is on `target` after `step`, and who comes from there to `cell` in that step."""
    visits = reservations.visits
    there = last_visit(visits, reservations.near, target, step)
    if visits[there].end >= step:
        add(neighborhood, visits[there].agent)
        there = visits[there].before
    here = last_visit(visits, reservations.near, cell, step)
    comes = visits[here].begin == step and target != cell
    if comes and visits[there].end == step - 1 and visits[here].agent == visits[there].agent:
        add(neighborhood, visits[here].agent)


@jit
def _passing_a_place(wanted: int, task: SippProblem, reservations: Reservations, neighborhood: Neighborhood) -> None:
    """Choose agents that pass the cells around a random cell on somebody's path, at about a random step."""
    visits, queue, seen = reservations.visits, neighborhood.queue, neighborhood.seen
    somebody = draw_below(neighborhood.random, task.goals.size)
    if reservations.first[somebody] == NONE:
        return
    step = draw_below(neighborhood.random, reservations.arrival[somebody] + 1)
    visit = reservations.first[somebody]
    while visits[visit].end < step:
        visit = visits[visit].then
    neighborhood.count[0] += 1
    queue[0] = visits[visit].cell
    seen[queue[0]] = neighborhood.count[0]
    head, tail = 0, 1
    while head < tail and neighborhood.size[0] < wanted:
        cell = queue[head]
        head += 1
        visit = last_visit(visits, reservations.near, cell, step)
        if visits[visit].agent != NONE:
            add(neighborhood, visits[visit].agent)
        visit = visits[visit].after
        if visit != NONE and neighborhood.size[0] < wanted:
            add(neighborhood, visits[visit].agent)
        for d in range(4):
            target = task.leads_to[d, cell]
            if seen[target] != neighborhood.count[0]:
                seen[target] = neighborhood.count[0]
                queue[tail] = target
                tail += 1
