"""Enhanced PIBT (EPIBT), which plans operations of several actions, and a local search that improves them.

Yukhnevich and Andreychuk, *Enhancing PIBT via Multi-Action Operations*, AAAI 2026. Each agent follows an operation, a
sequence of D actions. The operations of all agents are conflict-free at any time: initially all agents wait, and in
each step every agent continues its operation and appends a wait. In priority order, agents then choose better
operations. If an operation conflicts with that of exactly one agent, and that agent has a lower priority, then that
agent must replan at once, and may make others replan in the same way. As the agents agree on D actions instead of one,
they also agree on which of two agents passes a cell first.

The improvement is a local search over the operations, as in the winning entries of the League of Robot Runners: any
agent may ask any other agent to replan, if this lowers the sum of costs.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapf_pz.core.jit import jit
from mapf_pz.core.state import WAIT_WEIGHT, Array, PlanningView
from mapf_pz.planners.pibt.priority import priority_key, sort_by_key
from mapf_pz.planners.pibt.state import NO_AGENT, to_go

SEVERAL, NONE = -2, -1
AHEAD = 4
UNLIMITED, MARGIN = np.float32(np.inf), np.float32(1e-3)
"""No limit on costs; and the smallest change of the sum of costs that is not attributed to rounding."""
MAX_VISITS = 10
"""Maximum number of times an agent may be asked to replan in one step (the value of the paper's authors)."""


class Operations(NamedTuple):
    """P operations of D actions as a prefix tree of M nodes; node 0 is the root, every other node is an action."""

    parent: Array  # (M,) int32: the node of the previous action
    turn: Array  # (M,) int32: quarter turns to the right
    direction: Array  # (M,) int32: the direction of a move; 4: ahead; -1: no move
    action: Array  # (M,) int64: its number in the environment
    nodes: Array  # (P, D) int32: the nodes of each operation; ties are broken in favor of the first operation
    rest: Array  # (P,) int32: the operation that continues this one after its first action and ends with a wait
    wait: int  # the operation that only waits


class EpibtState(NamedTuple):
    """The operations of N agents on C cells, their alternatives, and scratch."""

    choice: Array  # (N,) int32: each agent's operation
    cell: Array  # (N,) int32: the cell after its first action; -1: no operation yet
    heading: Array  # (N,) int32: the heading after its first action
    path: Array  # (N, P, D + 1) int32: the cells of every operation, starting with the agent's cell
    cost: (
        Array  # (N, P) float32: cost of each operation plus the cost to go from its end; inf: it leads into an obstacle
    )
    to_go: Array  # (N,) float32: cost to go from the agent's state
    away: Array  # (N,) int32: steps since the agent was at its goal if agents must stay there; else 0
    order: Array  # (N,) int32: the agents, the highest priority first
    key: Array  # (N,) float64: each agent's sort key, lower first
    rank: Array  # (N,) int32: each agent's position in that order
    used: Array  # (D + 1, C + 1) int32: the agent on each cell, now and after each action; -1: none
    visits: Array  # (N,) int32: how often each agent was asked to replan
    waiting: Array  # (N,) bool: whether it is in the chain and waits for the next agent to replan
    chain: Array  # (N,) int32: agents, each of which has asked the next one to replan
    before: Array  # (N,) int32: the previous operation of each agent in the chain
    node_cell: Array  # (M,) int32: scratch for one agent
    node_heading: Array  # (M,) int32
    node_cost: Array  # (M,) float32
    node_ends: Array  # (M,) bool: the goal was passed, so further actions cost nothing


def allocate_epibt(planning_view: PlanningView, tree: Operations) -> EpibtState:
    """Allocate the state for an environment."""
    num_agents, cells = planning_view.agents.size, planning_view.occupant.size
    num_nodes, (size, depth) = len(tree.parent), tree.nodes.shape
    return EpibtState(
        choice=np.full(num_agents, tree.wait, np.int32),
        cell=np.full(num_agents, -1, np.int32),
        heading=np.zeros(num_agents, np.int32),
        path=np.zeros((num_agents, size, depth + 1), np.int32),
        cost=np.zeros((num_agents, size), np.float32),
        to_go=np.zeros(num_agents, np.float32),
        away=np.zeros(num_agents, np.int32),
        order=np.arange(num_agents, dtype=np.int32),
        key=np.zeros(num_agents, np.float64),
        rank=np.zeros(num_agents, np.int32),
        used=np.full((depth + 1, cells), NO_AGENT, np.int32),
        visits=np.zeros(num_agents, np.int32),
        waiting=np.zeros(num_agents, np.bool_),
        chain=np.zeros(num_agents, np.int32),
        before=np.zeros(num_agents, np.int32),
        node_cell=np.zeros(num_nodes, np.int32),
        node_heading=np.zeros(num_nodes, np.int32),
        node_cost=np.zeros(num_nodes, np.float32),
        node_ends=np.zeros(num_nodes, np.bool_),
    )


@jit
def plan(planning_view: PlanningView, passing: bool, tree: Operations, state: EpibtState) -> None:
    """Choose an operation for each agent.

    With `passing`, an agent only has to pass its goal; otherwise it must stay there.
    """
    agents = planning_view.agents
    _continue(agents, tree, state)
    _evaluate(planning_view, passing, tree, state)
    for i in range(agents.size):
        state.key[i] = priority_key(state.away[i], state.to_go[i])
    sort_by_key(state.key, state.order, state.chain)
    for position in range(agents.size):
        state.rank[state.order[position]] = position
    state.visits[:] = 0
    for i in state.order:
        if agents[i].active:
            _search(i, False, state)


@jit
def _continue(agents: Array, tree: Operations, state: EpibtState) -> None:
    """Let each agent continue its operation.

    If any agent is not in the expected state (new episode, different rules), all of them wait, which is always legal.
    """
    as_planned = True
    for i in range(agents.size):
        if agents[i].active:
            as_planned &= state.cell[i] == agents[i].cell and state.heading[i] == agents[i].heading
    for i in range(agents.size):
        state.choice[i] = tree.rest[state.choice[i]] if as_planned else tree.wait


@jit
def _evaluate(planning_view: PlanningView, passing: bool, tree: Operations, state: EpibtState) -> None:
    """Compute the cells and costs of all operations, and mark the cells that the agents' operations use."""
    agents, (size, depth) = planning_view.agents, tree.nodes.shape
    state.used[:] = NO_AGENT
    for i in range(agents.size):
        if not agents[i].active:
            continue
        state.to_go[i] = to_go(planning_view, agents[i], agents[i].cell, agents[i].heading)
        state.away[i] = 0 if passing or agents[i].cell == agents[i].goal else state.away[i] + 1
        _evaluate_tree(planning_view, agents[i], passing, tree, state)
        for p in range(size):
            state.path[i, p, 0] = agents[i].cell
            for t in range(depth):
                state.path[i, p, t + 1] = state.node_cell[tree.nodes[p, t]]
            state.cost[i, p] = state.node_cost[tree.nodes[p, depth - 1]]
        state.used[0, agents[i].cell] = i
        _occupy(state, i)


@jit
def _evaluate_tree(
    planning_view: PlanningView, agent: Array, passing: bool, tree: Operations, state: EpibtState
) -> None:
    """Compute the cell, heading and cost of every node from an agent's state; leaves' costs include the cost to go."""
    leads_to, weight = planning_view.leads_to, planning_view.weight
    cells, headings, cost, ends = state.node_cell, state.node_heading, state.node_cost, state.node_ends
    cells[0], headings[0], cost[0], ends[0] = agent.cell, agent.heading, 0.0, False
    for node in range(1, cells.size):
        before = tree.parent[node]
        cell, heading = cells[before], (headings[before] + tree.turn[node]) & 3
        step_cost = weight[WAIT_WEIGHT, cell]
        cells[node], headings[node] = cell, heading
        if tree.direction[node] >= 0:
            direction = heading if tree.direction[node] == AHEAD else tree.direction[node]
            cells[node] = leads_to[direction, cell]
            step_cost = weight[direction, cell]
        elif cell == agent.goal and tree.turn[node] == 0 and not passing:
            step_cost = 0.0
        cost[node] = cost[before] if ends[before] and step_cost < np.inf else cost[before] + step_cost
        ends[node] = ends[before] or (passing and cells[node] == agent.goal)
    for p in range(tree.nodes.shape[0]):
        leaf = tree.nodes[p, -1]
        if not ends[leaf]:
            cost[leaf] += to_go(planning_view, agent, cells[leaf], headings[leaf])


@jit
def improve_sum(sampled: Array, agents: Array, state: EpibtState) -> None:
    """For each of the agents `sampled` (K,), search for changes that lower the sum of costs."""
    for i in sampled:
        if agents[i].active:
            state.visits[:] = 0
            _search(i, True, state)


@jit
def _search(first: int, by_sum: bool, state: EpibtState) -> None:
    """Find a better operation for agent `first`, and new ones for the agents that it asks; else change nothing.

    With `by_sum`, the sum of all costs must decrease, and any agent may be asked. Otherwise the cost of `first` must
    decrease, and only agents of lower priority may be asked.
    """
    choice, cost, chain, before, waiting = state.choice, state.cost, state.chain, state.before, state.waiting
    chain[0], before[0] = first, choice[first]
    _release(state, first)
    choice[first] = NONE
    depth, change = 0, np.float32(0.0)  # of the sum of costs, by the new operations of the agents in the chain
    while True:
        i = chain[depth]
        old = cost[i, before[depth]]
        limit = old - change - MARGIN if by_sum else (old if depth == 0 else UNLIMITED)
        p = _next_option(cost[i], choice[i], limit)
        choice[i] = p
        if p == NONE:
            choice[i] = before[depth]
            if depth == 0:
                _occupy(state, i)
                return
            depth -= 1
            previous = chain[depth]
            _release(state, previous)
            _occupy(state, i)
            waiting[previous] = False
            change -= cost[previous, choice[previous]] - cost[previous, before[depth]]
            continue
        other = _conflicting_agent(state, i, p)
        if other == NO_AGENT:
            _occupy(state, i)
            for k in range(depth):
                waiting[chain[k]] = False
            return
        if other == SEVERAL or waiting[other] or state.visits[other] >= MAX_VISITS:
            continue
        if not by_sum and state.rank[other] < state.rank[first]:
            continue
        state.visits[other] += 1
        _release(state, other)
        _occupy(state, i)
        waiting[i] = True
        change += cost[i, p] - old
        depth += 1
        chain[depth], before[depth] = other, choice[other]
        choice[other] = NONE


@jit
def _next_option(cost: Array, last: int, limit: np.float32) -> int:
    """Return the operation after `last` in the order of costs, or NONE if its cost is not below `limit`."""
    best, least = NONE, limit
    for p in range(cost.size):
        after = last == NONE or cost[p] > cost[last] or (cost[p] == cost[last] and p > last)
        if after and cost[p] < least:
            best, least = p, cost[p]
    return best


@jit
def _conflicting_agent(state: EpibtState, i: int, p: int) -> int:
    """Return the agent whose operation conflicts with operation `p` of agent `i`, or NO_AGENT, or SEVERAL."""
    path, used, found = state.path[i, p], state.used, NO_AGENT
    for t in range(1, path.size):
        here, there = path[t - 1], path[t]
        occupant = used[t, there]
        if occupant != NO_AGENT and occupant != found:
            if found != NO_AGENT:
                return SEVERAL
            found = occupant
        leaving = used[t - 1, there]
        if here != there and leaving != NO_AGENT and leaving != found and used[t, here] == leaving:  # a swap
            if found != NO_AGENT:
                return SEVERAL
            found = leaving
    return found


@jit
def _occupy(state: EpibtState, i: int) -> None:
    path = state.path[i, state.choice[i]]
    for t in range(1, path.size):
        state.used[t, path[t]] = i


@jit
def _release(state: EpibtState, i: int) -> None:
    path = state.path[i, state.choice[i]]
    for t in range(1, path.size):
        state.used[t, path[t]] = NO_AGENT


@jit
def first_actions(agents: Array, tree: Operations, state: EpibtState, actions: Array) -> None:
    """Write each agent's first action (N,) int64, and store the state that it leads to."""
    for i in range(agents.size):
        node = tree.nodes[state.choice[i], 0]
        actions[i] = tree.action[node]
        state.cell[i] = state.path[i, state.choice[i], 1]
        state.heading[i] = (agents[i].heading + tree.turn[node]) % 4
