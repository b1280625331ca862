"""The execution of a dependency graph in which agents may change their order at cells.

Of two agents that need the same cell, the plan has one go first. If that one is late, the other one may go first, and
then also on the cells after it that both need. Such graphs are called switchable (Berndt et al., ICRA 2020); Feng et
al., ICAPS 2024, search for the best orders. Here, orders are changed one at a time, where the agents are predicted to
wait for fewer steps: the rest of the execution is simulated with either order.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapf_pz._internal.arrays import Bools
from mapf_pz._internal.jit import Array, jit
from mapf_pz.planners.plans.dependencies import NONE, DependencyGraph, find_visits
from mapf_pz.planners.plans.execution import Execution

UNBOUNDED = 2**62
STAYS, ACTS, UNKNOWN, ASKED = 0, 1, 2, 3  # whether an agent acts in a step; ASKED: its leader is being asked


class SwitchableExecution(Execution):
    """An execution that lets an agent go before a late one where that is predicted to be cheaper.

    The prediction expects that an agent that is delayed will be so for as many steps again as it has been, and that no
    others will be. An order in which agents would wait forever is not taken, so there is no deadlock.
    """

    def __init__(self, graph: DependencyGraph) -> None:
        """Start with all agents at their starts, and the orders of the graph."""
        super().__init__(graph)
        self.waits_for = graph.waits_for.copy()
        self._visits = visits_of(graph)
        self._delayed_for = np.zeros(graph.num_agents, np.int64)
        self._scratch = allocate(graph.num_agents, len(self._visits.agent))

    def advance(self, acted: Bools, delayed: Bools | None = None) -> None:
        """Count the actions that the agents `acted` (N,) have executed in a step, and change orders for the next one.

        Args:
            acted: (N,) bool: the agents that acted.
            delayed: (N,) bool: the agents that were delayed. None: no agent.

        Raises `ValueError` if an agent had no action left, or did not wait as the present orders say.
        """
        super().advance(acted, delayed)
        self._delayed_for = np.where(False if delayed is None else delayed, self._delayed_for + 1, 0)
        progress = Progress(self.graph.first, self._agents, self.waits_for, self.states, self._delayed_for)
        improve_order(self._visits, progress, self._scratch)


class Visits(NamedTuple):
    """The visits of agents to cells, in the order in which they begin, those of each agent together; V visits."""

    agent: Array  # (V,) int64
    enter: Array  # (V,) int64: the state in which the visit begins
    leave: Array  # (V,) int64: the state of the next visit; NONE: the agent stays
    before: Array  # (V,) int64: the visit to the same cell before this one; NONE: there is none
    after: Array  # (V,) int64: the visit to the same cell after this one; NONE: there is none
    of_state: Array  # (S,) int64: the visit that begins in each state; NONE: none


class Progress(NamedTuple):
    """How far an execution is; N agents, S states."""

    first: Array  # (N + 1,) int64: the first state of each agent, and S
    agent: Array  # (S,) int64: the agent of each state
    waits_for: Array  # (S,) int64: the state that has to be reached before each state, or with it; NONE
    states: Array  # (N,) int64: the state of each agent
    held: Array  # (N,) int64: for how many steps each agent is expected to be delayed from now on


class Scratch(NamedTuple):
    """Room for the search; N agents."""

    passed: Array  # (N,) int64: the latest visit in which each agent was passed
    before: Array  # (V,) int64: the former place of the visits that were moved
    after: Array  # (V,) int64
    states: Array  # (N,) int64: of the prediction, as in `Progress`
    held: Array  # (N,) int64
    acts: Array  # (N,) int64
    agents: Array  # (N,) int64: the agents that have actions left


def visits_of(graph: DependencyGraph) -> Visits:
    """Return the visits of a graph, in the orders of its plan."""
    agents = graph.agents
    enter, leave, one, other = find_visits(agents, graph.steps, graph.positions)
    before, after = np.full((2, len(enter)), NONE)
    before[other], after[one] = one, other
    of_state = np.full(len(agents), NONE)
    of_state[enter] = np.arange(len(enter))
    return Visits(agents[enter], enter, np.where(leave == len(agents), NONE, leave), before, after, of_state)


def allocate(num_agents: int, num_visits: int) -> Scratch:
    """Return room for the search."""
    of_agents, of_visits = np.zeros((5, num_agents), np.int64), np.zeros((2, num_visits), np.int64)
    return Scratch(of_agents[0], of_visits[0], of_visits[1], *of_agents[1:])


@jit
def improve_order(visits: Visits, progress: Progress, scratch: Scratch) -> None:
    """Let agents that wait for others go first where that is predicted to be cheaper."""
    best = predict(progress, UNBOUNDED, scratch)
    for agent in range(len(progress.states)):
        state = progress.states[agent] + 1
        if state == progress.first[agent + 1] or progress.held[agent]:
            continue
        visit = visits.of_state[state]
        if visit == NONE or visits.before[visit] == NONE or is_begun(visits, progress, visits.before[visit]):
            continue
        num_moves = go_first(visits, progress, visit, scratch)
        cost = predict(progress, best, scratch)
        if cost < best:
            best = cost
        else:
            for k in range(num_moves - 1, -1, -1):
                place(visits, progress, visit + k, scratch.before[k], scratch.after[k])


@jit
def is_begun(visits: Visits, progress: Progress, visit: int) -> bool:
    """Return whether the agent of a visit has reached the state in which it begins."""
    return visits.enter[visit] <= progress.states[visits.agent[visit]]


@jit
def go_first(visits: Visits, progress: Progress, visit: int, scratch: Scratch) -> int:
    """Put a visit before the one before it, and the agent's next visits before those of the agents that it passes.

    Writes the former places to `scratch`, and returns the number of visits that were moved.
    """
    me, first, passed = visits.agent[visit], visit, scratch.passed
    passed[:] = NONE
    passed[visits.agent[visits.before[visit]]] = visit - 1
    while visit < len(visits.agent) and visits.agent[visit] == me:
        target, other = NONE, visits.before[visit]
        while other != NONE and not is_begun(visits, progress, other):
            if visits.agent[other] != me and passed[visits.agent[other]] == visit - 1:
                target = other
            other = visits.before[other]
        if target == NONE:
            break
        other = visits.before[visit]
        while other != visits.before[target]:
            passed[visits.agent[other]] = visit
            other = visits.before[other]
        scratch.before[visit - first], scratch.after[visit - first] = visits.before[visit], visits.after[visit]
        place(visits, progress, visit, visits.before[target], target)
        visit += 1
    return visit - first


@jit
def place(visits: Visits, progress: Progress, visit: int, before: int, after: int) -> None:
    """Move a visit between two others of its cell; `NONE`: the end of the list."""
    follower = visits.after[visit]
    link(visits, visits.before[visit], follower)
    link(visits, before, visit)
    link(visits, visit, after)
    for each in (visit, after, follower):
        if each != NONE:
            update_wait(visits, progress, each)


@jit
def link(visits: Visits, one: int, other: int) -> None:
    """Make one visit follow another; `NONE`: the end of the list."""
    if one != NONE:
        visits.after[one] = other
    if other != NONE:
        visits.before[other] = one


@jit
def update_wait(visits: Visits, progress: Progress, visit: int) -> None:
    """Write which state the first state of a visit waits for."""
    before = visits.before[visit]
    waits = before != NONE and visits.agent[before] != visits.agent[visit]
    # An agent that stays never leaves, so that the visit would wait for itself.
    leave = visits.leave[before] if waits else NONE
    progress.waits_for[visits.enter[visit]] = visits.enter[visit] if waits and leave == NONE else leave


@jit
def predict(progress: Progress, limit: int, scratch: Scratch) -> int:
    """Return in how many steps agents wait, all together, until all actions are executed, if no others are delayed.

    At least `limit` if it is not lower, or if agents wait forever.
    """
    states, held, acts, agents = scratch.states, scratch.held, scratch.acts, scratch.agents
    states[:], held[:] = progress.states, progress.held
    left = 0
    for i in range(len(states)):
        if states[i] + 1 < progress.first[i + 1]:
            agents[left] = i
            left += 1
        else:
            acts[i] = STAYS
    cost = 0
    while left and cost < limit:
        for k in range(left):
            acts[agents[k]] = UNKNOWN
        for k in range(left):
            if acts[agents[k]] == UNKNOWN:
                decide(progress, states, held, acts, agents[k])
        moving, kept = False, 0
        for k in range(left):
            i = agents[k]
            moving |= acts[i] == ACTS or held[i] > 0
            held[i] = max(held[i] - 1, 0)
            if acts[i] == ACTS:
                states[i] += 1
            else:
                cost += 1
            if states[i] + 1 < progress.first[i + 1]:
                agents[kept] = i
                kept += 1
            else:
                acts[i] = STAYS
        if not moving:
            return limit
        left = kept
    return cost


@jit
def decide(progress: Progress, states: Array, held: Array, acts: Array, i: int) -> None:
    """Write to `acts` whether agent i acts, and the agents that this depends on, each of which waits for the next."""
    one = i
    while acts[one] == UNKNOWN:
        state = states[one] + 1
        if held[one]:
            acts[one] = STAYS
            break
        awaited = progress.waits_for[state]
        leader = progress.agent[awaited] if awaited != NONE else one
        if awaited == NONE or awaited <= states[leader]:
            acts[one] = ACTS
        elif awaited != states[leader] + 1 or progress.waits_for[awaited] == state:
            acts[one] = STAYS  # the cell is not left in this step, or the two would swap cells
        else:
            acts[one] = ASKED
            one = leader
    result = STAYS if acts[one] == STAYS else ACTS  # a cycle of agents moves together
    one = i
    while acts[one] == ASKED:
        acts[one] = result
        one = progress.agent[progress.waits_for[states[one] + 1]]
