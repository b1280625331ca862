"""The neighborhoods of a large neighborhood search: sets of agents to replan together.

They are those of Li et al., *Anytime Multi-Agent Path Finding via Large Neighborhood Search*, IJCAI 2021: agents in the
way of a delayed agent (agent-based), agents that pass a part of the map (map-based), and random agents. A fourth kind
is for an agent without a path: the agents in the way on a shortest path.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapf_pz._internal.jit import Array, jit
from mapf_pz.planners.random import draw_below, seeded
from mapf_pz.planners.sipp.reservations import FOREVER, NONE, Reservations, direction_after, last_visit
from mapf_pz.planners.sipp.search import SippProblem
from mapf_pz.simulator.kernels.cost_lookup import num_headings, unpack_steps

AGENT_BASED, MAP_BASED, RANDOM = range(3)
KINDS = 3


class Neighborhood(NamedTuple):
    """A subset of N agents on C cells, and the state of the random numbers that choose it."""

    agents: Array  # (N,) int32: the first `size` are in the neighborhood
    size: Array  # (1,) int64
    chosen: Array  # (N,) bool: whether each agent is in the neighborhood
    queue: Array  # (C + 1,) int32: scratch for breadth-first searches
    seen: Array  # (C + 1,) int64: the number of the last search that visited each cell
    count: Array  # (1,) int64: number of searches
    random: Array  # (1,) uint64


def allocate_neighborhood(num_agents: int, num_cells: int, seed: int) -> Neighborhood:
    """Allocate an empty neighborhood for N agents on C cells; `seed` must not be 0."""
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
    kind: int, wanted: int, problem: SippProblem, reservations: Reservations, neighborhood: Neighborhood
) -> None:
    """Choose at most `wanted` agents by one of the `KINDS`; sometimes none."""
    clear(neighborhood)
    if kind == AGENT_BASED:
        _choose_around_delayed(wanted, problem, reservations, neighborhood)
    elif kind == MAP_BASED:
        _choose_around_cell(wanted, problem, reservations, neighborhood)
    else:
        while neighborhood.size[0] < min(wanted, problem.goals.size):
            add(neighborhood, draw_below(neighborhood.random, problem.goals.size))


@jit
def choose_around_missing(
    wanted: int, problem: SippProblem, reservations: Reservations, neighborhood: Neighborhood
) -> None:
    """Choose one of the agents without a path, and at most `wanted` - 1 other agents in its way."""
    clear(neighborhood)
    agent = draw_below(neighborhood.random, problem.goals.size)
    while reservations.first[agent] != NONE:
        agent = (agent + 1) % problem.goals.size
    add(neighborhood, agent)
    start, heading = problem.starts[agent], problem.headings[agent]
    for _ in range(10):
        # Walks are random, so several of them meet more agents; with enough agents, they return at once.
        _add_along_walk(agent, start, heading, 0, FOREVER, wanted, problem, reservations, neighborhood)


@jit
def clear(neighborhood: Neighborhood) -> None:
    """Empty the neighborhood."""
    for k in range(neighborhood.size[0]):
        neighborhood.chosen[neighborhood.agents[k]] = False
    neighborhood.size[0] = 0


@jit
def add(neighborhood: Neighborhood, agent: int) -> None:
    """Add an agent to the neighborhood, if it is not in it yet."""
    if not neighborhood.chosen[agent]:
        neighborhood.chosen[agent] = True
        neighborhood.agents[neighborhood.size[0]] = agent
        neighborhood.size[0] += 1


@jit
def shuffle(neighborhood: Neighborhood) -> None:
    """Shuffle the agents of the neighborhood."""
    agents = neighborhood.agents
    for k in range(neighborhood.size[0] - 1, 0, -1):
        other = draw_below(neighborhood.random, k + 1)
        agents[k], agents[other] = agents[other], agents[k]


@jit
def cost_of(reservations: Reservations, agent: int) -> int:
    """Return the cost of an agent that has a path, as in `Plan.costs`."""
    return max(reservations.arrival[agent], 1)


@jit
def delay(problem: SippProblem, reservations: Reservations, agent: int) -> int:
    """Return how much more than on an empty map an agent costs, or 0 if it has no path."""
    if reservations.first[agent] == NONE:
        return 0
    return cost_of(reservations, agent) - shortest(problem, agent)


@jit
def shortest(problem: SippProblem, agent: int) -> int:
    """Return the cost of an agent on an empty map."""
    return max(unpack_steps(problem.steps[problem.table[agent], problem.starts[agent]], problem.headings[agent]), 1)


@jit
def sum_of_shortest(problem: SippProblem) -> int:
    """Return the sum of the costs of all agents on an empty map."""
    total = 0
    for agent in range(problem.goals.size):
        total += shortest(problem, agent)
    return total


@jit
def _choose_around_delayed(
    wanted: int, problem: SippProblem, reservations: Reservations, neighborhood: Neighborhood
) -> None:
    """Choose an agent in proportion to its delay, and agents in the way of random walks on which it arrives earlier."""
    visits = reservations.visits
    total = 0
    for i in range(problem.goals.size):
        total += delay(problem, reservations, i)
    if total == 0:
        return
    # Li et al. 2021 take the agent with the largest delay that was not taken lately; a random one needs no list of
    # these.
    threshold = draw_below(neighborhood.random, total)
    agent = 0
    while threshold >= delay(problem, reservations, agent):
        threshold -= delay(problem, reservations, agent)
        agent += 1
    add(neighborhood, agent)
    length = 0
    visit = reservations.first[agent]
    while visit != NONE:
        length += 1
        visit = visits[visit].next
    for _ in range(10):
        visit, heading = reservations.first[agent], problem.headings[agent]
        # The walk starts anywhere on the path, because the agent may be delayed anywhere on it.
        for _ in range(draw_below(neighborhood.random, length)):
            heading = direction_after(visits, problem.leads_to, visit, heading)
            visit = visits[visit].next
        cell, step, arrival = visits[visit].cell, visits[visit].begin, reservations.arrival[agent]
        _add_along_walk(agent, cell, heading, step, arrival, wanted, problem, reservations, neighborhood)


@jit
def _add_along_walk(
    agent: int, cell: int, heading: int, step: int, arrival: int, wanted: int, problem: SippProblem,
    reservations: Reservations, neighborhood: Neighborhood
) -> None:  # fmt: skip
    """Add the agents in the way of a random walk of `agent` that arrives before `arrival`.

    If `arrival` is `FOREVER`, the walk follows a shortest path, and agents that cross the goal later are added, too.
    """
    visits, headings = reservations.visits, num_headings(problem.to_go)
    steps = problem.steps[problem.table[agent]]
    heading %= headings
    while neighborhood.size[0] < wanted and unpack_steps(steps[cell], heading) > 0:
        # An upper bound on the steps to go after the next step, with which the agent still arrives earlier than now.
        left = unpack_steps(steps[cell], heading) if arrival == FOREVER else arrival - step - 1
        target, facing, found = cell, heading, 0
        for choice in range(5):
            following, turned = cell, heading
            if headings == 1:
                following = cell if choice == 4 else problem.leads_to[choice, cell]
            elif choice == 0:
                following = problem.leads_to[heading, cell]
            elif choice == 1 or choice == 3:
                turned = (heading + choice) % 4
            if unpack_steps(steps[following], turned) < left:
                found += 1
                # Reservoir sampling: each of the possible actions is equally likely, without a list of them.
                if draw_below(neighborhood.random, found) == 0:
                    target, facing = following, turned
        if found == 0:
            return
        step += 1
        _add_colliding(cell, target, step, reservations, neighborhood)
        cell, heading = target, facing
    visit = last_visit(visits, reservations.near, cell, step)
    # An agent that stays at its goal is also in the way of all that cross this cell later.
    while arrival == FOREVER and visit != NONE and neighborhood.size[0] < wanted:
        if visits[visit].end >= step:
            add(neighborhood, visits[visit].agent)
        visit = visits[visit].after


@jit
def _add_colliding(cell: int, target: int, step: int, reservations: Reservations, neighborhood: Neighborhood) -> None:
    """Add the agent that is on `target` after `step`, and the agent that moves from there to `cell` in that step."""
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
def _choose_around_cell(
    wanted: int, problem: SippProblem, reservations: Reservations, neighborhood: Neighborhood
) -> None:
    """Choose agents that pass the cells around a random cell of a random agent's path, around a random step."""
    visits, queue, seen = reservations.visits, neighborhood.queue, neighborhood.seen
    agent = draw_below(neighborhood.random, problem.goals.size)
    if reservations.first[agent] == NONE:
        return
    step = draw_below(neighborhood.random, reservations.arrival[agent] + 1)
    visit = reservations.first[agent]
    while visits[visit].end < step:
        visit = visits[visit].next
    neighborhood.count[0] += 1
    # A breadth-first search, so that the agents are those around the cell, until there are enough.
    queue[0] = visits[visit].cell
    seen[queue[0]] = neighborhood.count[0]
    head, tail = 0, 1
    while head < tail and neighborhood.size[0] < wanted:
        cell = queue[head]
        head += 1
        visit = last_visit(visits, reservations.near, cell, step)
        # Of each cell, the visits just before and just after the step: their agents compete for it.
        if visits[visit].agent != NONE:
            add(neighborhood, visits[visit].agent)
        visit = visits[visit].after
        if visit != NONE and neighborhood.size[0] < wanted:
            add(neighborhood, visits[visit].agent)
        for d in range(4):
            target = problem.leads_to[d, cell]
            if seen[target] != neighborhood.count[0]:
                seen[target] = neighborhood.count[0]
                queue[tail] = target
                tail += 1
