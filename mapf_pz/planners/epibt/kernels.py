"""PIBT with operations of several actions (EPIBT), and their improvement: one step for all agents of one environment.

Yukhnevich and Andreychuk, *Enhancing PIBT via Multi-Action Operations*, AAAI 2026. Each agent follows an operation, a
path of D actions from where it is. All operations together are free of conflicts: at first everybody waits, and in each
step everybody goes on with the rest of its operation, and a wait. In the order of their priorities agents then take
better operations; who is in the way, if that is a single agent of lower priority, must find another one at once, and
may ask in the same way. As all agree on D actions and not on one, two that need the same cell settle who goes first.

The improvement is a local search over the operations, as in the entries that won the League of Robot Runners: any
agent may ask any other, if that makes the sum of the costs smaller.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapf_pz.core.jit import jit
from mapf_pz.core.state import WAIT_WEIGHT, Array, PlanningView
from mapf_pz.planners.pibt.kernels import NOBODY, sort_by_priority, to_go

SEVERAL, NONE = -2, -1
AHEAD = 4
UNLIMITED, MARGIN = np.float32(np.inf), np.float32(1e-3)
"""A limit on costs; and what changes of the sum must exceed, as smaller ones may be rounding."""
MAX_VISITS = 10
"""So often is an agent asked in one step; more is not worth the time (the authors' number)."""


class Operations(NamedTuple):
    """P operations of D actions as a tree of M nodes: the root 0, and one for each action after another."""

    parent: Array  # (M,) int32: the action before
    turn: Array  # (M,) int32: quarter turns to the right
    towards: Array  # (M,) int32: the heading of a move; 4: ahead; -1: no move
    action: Array  # (M,) int64: its number in the environment
    nodes: Array  # (P, D) int32: the actions of each operation; of equally good ones the first is taken
    rest: Array  # (P,) int32: the operation that goes on with this one after its first action, and ends with a wait
    waits: int  # the operation that only waits


class EpibtState(NamedTuple):
    """What N agents on C cells do, and what else they could do."""

    choice: Array  # (N,) int32: the operation of each
    cell: Array  # (N,) int32: where its first action leads to; -1: there was none yet
    heading: Array  # (N,) int32
    path: Array  # (N, P, D + 1) int32: the cells of every operation, from where the agent is
    cost: Array  # (N, P) float32: of it and of the way from its end; inf: it leads into an obstacle
    to_go: Array  # (N,) float32: from where the agent is
    away: Array  # (N,) int32: so many steps it is away from its goal, where it shall stay there; else 0
    order: Array  # (N,) int32: the agents, the highest priority first
    key: Array  # (N,) float64: what that order is by
    rank: Array  # (N,) int32: the place of each in that order
    used: Array  # (D + 1, C + 1) int32: the agent on each cell, now and after each action; -1: nobody
    visits: Array  # (N,) int32: how often an agent was asked
    asking: Array  # (N,) bool: it has asked another one
    chain: Array  # (N,) int32: who asked whom
    before: Array  # (N,) int32: the operation that each in the chain had
    node_cell: Array  # (M,) int32: scratch for one agent
    node_heading: Array  # (M,) int32
    node_cost: Array  # (M,) float32
    node_ends: Array  # (M,) bool: it has passed its goal, and the rest costs nothing


def allocate_epibt(planning_view: PlanningView, tree: Operations) -> EpibtState:
    """Make room for an environment's agents and cells."""
    num_agents, cells = planning_view.agents.size, planning_view.occupant.size
    num_nodes, (size, depth) = len(tree.parent), tree.nodes.shape
    return EpibtState(
        choice=np.full(num_agents, tree.waits, np.int32),
        cell=np.full(num_agents, -1, np.int32),
        heading=np.zeros(num_agents, np.int32),
        path=np.zeros((num_agents, size, depth + 1), np.int32),
        cost=np.zeros((num_agents, size), np.float32),
        to_go=np.zeros(num_agents, np.float32),
        away=np.zeros(num_agents, np.int32),
        order=np.arange(num_agents, dtype=np.int32),
        key=np.zeros(num_agents, np.float64),
        rank=np.zeros(num_agents, np.int32),
        used=np.full((depth + 1, cells), NOBODY, np.int32),
        visits=np.zeros(num_agents, np.int32),
        asking=np.zeros(num_agents, np.bool_),
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

    With `passing`, to pass its goal is all that an agent wants; otherwise it shall stay there.
    """
    agents = planning_view.agents
    _go_on(agents, tree, state)
    _rate(planning_view, passing, tree, state)
    sort_by_priority(state.away, state.to_go, state.order, state.key)
    for place in range(agents.size):
        state.rank[state.order[place]] = place
    state.visits[:] = 0
    for i in state.order:
        if agents[i].active:
            _search(i, False, state)


@jit
def _go_on(agents: Array, tree: Operations, state: EpibtState) -> None:
    """Give each agent the rest of its operation.

    Where any is not where it should be (another episode, other rules) all of them wait, which is always possible.
    """
    as_planned = True
    for i in range(agents.size):
        if agents[i].active:
            as_planned &= state.cell[i] == agents[i].cell and state.heading[i] == agents[i].heading
    for i in range(agents.size):
        state.choice[i] = tree.rest[state.choice[i]] if as_planned else tree.waits


@jit
def _rate(planning_view: PlanningView, passing: bool, tree: Operations, state: EpibtState) -> None:
    """Find cells and costs of all operations, and mark the cells that agents use."""
    agents, (size, depth) = planning_view.agents, tree.nodes.shape
    state.used[:] = NOBODY
    for i in range(agents.size):
        if not agents[i].active:
            continue
        state.to_go[i] = to_go(planning_view, agents[i], agents[i].cell, agents[i].heading)
        state.away[i] = 0 if passing or agents[i].cell == agents[i].goal else state.away[i] + 1
        _walk(planning_view, agents[i], passing, tree, state)
        for p in range(size):
            state.path[i, p, 0] = agents[i].cell
            for t in range(depth):
                state.path[i, p, t + 1] = state.node_cell[tree.nodes[p, t]]
            state.cost[i, p] = state.node_cost[tree.nodes[p, depth - 1]]
        state.used[0, agents[i].cell] = i
        _put(state, i)


@jit
def _walk(planning_view: PlanningView, agent: Array, passing: bool, tree: Operations, state: EpibtState) -> None:
    """Follow the tree from an agent's state; leaves' costs include the way from there."""
    leads_to, weight = planning_view.leads_to, planning_view.weight
    cells, headings, cost, ends = state.node_cell, state.node_heading, state.node_cost, state.node_ends
    cells[0], headings[0], cost[0], ends[0] = agent.cell, agent.heading, 0.0, False
    for node in range(1, cells.size):
        before = tree.parent[node]
        cell, heading = cells[before], (headings[before] + tree.turn[node]) & 3
        price = weight[WAIT_WEIGHT, cell]
        cells[node], headings[node] = cell, heading
        if tree.towards[node] >= 0:
            towards = heading if tree.towards[node] == AHEAD else tree.towards[node]
            cells[node] = leads_to[towards, cell]
            price = weight[towards, cell]
        elif cell == agent.goal and tree.turn[node] == 0 and not passing:
            price = 0.0
        cost[node] = cost[before] if ends[before] and price < np.inf else cost[before] + price
        ends[node] = ends[before] or (passing and cells[node] == agent.goal)
    for p in range(tree.nodes.shape[0]):
        leaf = tree.nodes[p, -1]
        if not ends[leaf]:
            cost[leaf] += to_go(planning_view, agent, cells[leaf], headings[leaf])


@jit
def improve_sum(draws: Array, agents: Array, state: EpibtState) -> None:
    """Let the agents `draws` (K,) one after the other look for changes that lower the sum of the costs."""
    for i in draws:
        if agents[i].active:
            state.visits[:] = 0
            _search(i, True, state)


@jit
def _search(first: int, by_sum: bool, state: EpibtState) -> None:
    """Find a better operation for agent `first`, and others for all whom it must ask; else everything stays.

    `by_sum`: better is what lowers the sum of all costs, and anybody may be asked. Otherwise what lowers the cost of
    `first`, and those after it in the order may be asked.
    """
    choice, cost, chain, before, asking = state.choice, state.cost, state.chain, state.before, state.asking
    chain[0], before[0] = first, choice[first]
    _take(state, first)
    choice[first] = NONE
    depth, change = 0, np.float32(0.0)  # of the sum, by the operations of those who ask
    while True:
        i = chain[depth]
        old = cost[i, before[depth]]
        limit = old - change - MARGIN if by_sum else (old if depth == 0 else UNLIMITED)
        p = _next_option(cost[i], choice[i], limit)
        choice[i] = p
        if p == NONE:
            choice[i] = before[depth]
            if depth == 0:
                _put(state, i)
                return
            depth -= 1
            asker = chain[depth]
            _take(state, asker)
            _put(state, i)
            asking[asker] = False
            change -= cost[asker, choice[asker]] - cost[asker, before[depth]]
            continue
        other = _in_the_way(state, i, p)
        if other == NOBODY:
            _put(state, i)
            for k in range(depth):
                asking[chain[k]] = False
            return
        if other == SEVERAL or asking[other] or state.visits[other] >= MAX_VISITS:
            continue
        if not by_sum and state.rank[other] < state.rank[first]:
            continue
        state.visits[other] += 1
        _take(state, other)
        _put(state, i)
        asking[i] = True
        change += cost[i, p] - old
        depth += 1
        chain[depth], before[depth] = other, choice[other]
        choice[other] = NONE


@jit
def _next_option(cost: Array, last: int, limit: np.float32) -> int:
    """Return the operation that comes after `last` in the order of their costs, if it costs less than `limit`."""
    best, least = NONE, limit
    for p in range(cost.size):
        after = last == NONE or cost[p] > cost[last] or (cost[p] == cost[last] and p > last)
        if after and cost[p] < least:
            best, least = p, cost[p]
    return best


@jit
def _in_the_way(state: EpibtState, i: int, p: int) -> int:
    """Return the one agent whose operation conflicts with operation `p` of agent `i`; or NOBODY, or SEVERAL."""
    path, used, found = state.path[i, p], state.used, NOBODY
    for t in range(1, path.size):
        here, there = path[t - 1], path[t]
        on_it = used[t, there]
        if on_it != NOBODY and on_it != found:
            if found != NOBODY:
                return SEVERAL
            found = on_it
        leaving = used[t - 1, there]
        if here != there and leaving != NOBODY and leaving != found and used[t, here] == leaving:  # they change places
            if found != NOBODY:
                return SEVERAL
            found = leaving
    return found


@jit
def _put(state: EpibtState, i: int) -> None:
    path = state.path[i, state.choice[i]]
    for t in range(1, path.size):
        state.used[t, path[t]] = i


@jit
def _take(state: EpibtState, i: int) -> None:
    path = state.path[i, state.choice[i]]
    for t in range(1, path.size):
        state.used[t, path[t]] = NOBODY


@jit
def first_actions(agents: Array, tree: Operations, state: EpibtState, actions: Array) -> None:
    """Write each agent's first action (N,) int64, and remember where it leads to."""
    for i in range(agents.size):
        node = tree.nodes[state.choice[i], 0]
        actions[i] = tree.action[node]
        state.cell[i] = state.path[i, state.choice[i], 1]
        state.heading[i] = (agents[i].heading + tree.turn[node]) % 4
