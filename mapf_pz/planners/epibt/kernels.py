"""Enhanced PIBT (EPIBT), which plans operations of several actions, and a local search that improves them.

Yukhnevich and Andreychuk, *Enhancing PIBT via Multi-Action Operations*, AAAI 2026. Each agent follows an operation, a
sequence of D actions. The operations of all agents are conflict-free at any time: initially all agents wait, and in
each step every agent continues its operation and appends a wait. In priority order, agents then try their operations,
the cheapest first, and of equally cheap ones those that move early. If an operation conflicts with that of exactly one
agent, and that agent has a lower priority, then that agent must replan at once, and may make others replan in the same
way. An agent that only has to pass its goal prefers any operation to waiting all the time, so that it makes way. As the
agents agree on D actions instead of one, they also agree on which of two agents passes a cell first.
"""

from __future__ import annotations

import numpy as np

from mapf_pz._internal.jit import Array, jit
from mapf_pz.planners.epibt.search import mark, search
from mapf_pz.planners.epibt.state import AHEAD, NONE, OPERATION_BITS, EpibtState, Operations
from mapf_pz.planners.pibt.priority import priority_key, sort_by_key
from mapf_pz.planners.pibt.state import NO_AGENT, to_go
from mapf_pz.simulator.kernels.state import WAIT_WEIGHT, PlanningView

EARLY = 0.5
"""How much more the last operation costs than the first one at equal costs, in units of the cost of a wait."""


@jit
def plan(planning_view: PlanningView, passing: bool, tree: Operations, state: EpibtState) -> None:
    """Choose an operation for each agent.

    With `passing`, an agent only has to pass its goal; otherwise it must stay there.
    """
    continue_operations(planning_view.agents, tree, state)
    evaluate(planning_view, passing, tree, state)
    decide(planning_view.agents, state)


@jit
def decide(agents: Array, state: EpibtState) -> None:
    """Choose an operation for each agent among its `state.options`, in priority order."""
    for i in range(agents.size):
        state.key[i] = priority_key(state.away[i], state.to_go[i])
    sort_by_key(state.key, state.order, state.merged)
    for position in range(agents.size):
        state.rank[state.order[position]] = position
    state.region[:] = 0
    for i in state.order:
        if agents[i].active:
            search(i, False, 0, state)
    state.visits[:] = 0


@jit
def continue_operations(agents: Array, tree: Operations, state: EpibtState) -> None:
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
def evaluate(planning_view: PlanningView, passing: bool, tree: Operations, state: EpibtState) -> None:
    """Compute the cells and costs of all operations, and mark the cells that the agents' operations use."""
    agents, (size, depth), regular = planning_view.agents, tree.nodes.shape, tree.num_regular
    wait = _smallest_wait(planning_view)
    early = EARLY * wait / regular
    state.used[:] = NO_AGENT
    for i in range(agents.size):
        if not agents[i].active:
            continue
        state.to_go[i] = to_go(planning_view, agents[i], agents[i].cell, agents[i].heading)
        state.away[i] = 0 if passing or agents[i].cell == agents[i].goal else state.away[i] + 1
        _evaluate_tree(planning_view, agents[i], passing, wait, tree, state)
        for p in range(size):
            state.path[i, p, 0] = agents[i].cell
            for t in range(depth):
                state.path[i, p, t + 1] = state.node_cell[tree.nodes[p, t]]
            state.cost[i, p] = state.node_cost[tree.nodes[p, depth - 1]] + p * early
        state.num_options[i] = _sort_options(regular, state.cost[i], tree.wait if passing else NONE, state.options[i])
        state.used[0, agents[i].cell] = i
        mark(state.used, state.path[i, state.choice[i]], i)


@jit
def _smallest_wait(planning_view: PlanningView) -> np.float32:
    """Return the smallest cost of a wait in a cell that agents can leave; 1 if there is none."""
    smallest = np.float32(np.inf)
    for cell in range(planning_view.leads_to.shape[1] - 1):
        for direction in range(4):
            if planning_view.leads_to[direction, cell] != cell:
                smallest = min(smallest, planning_view.weight[WAIT_WEIGHT, cell])
    return smallest if smallest < np.inf else np.float32(1)


@jit
def _sort_options(num_regular: int, cost: Array, excluded: int, options: Array) -> int:
    """Write the possible operations except `excluded` to `options` (P,), the cheapest first; return their number."""
    count = 0
    for p in range(num_regular):
        if p != excluded and cost[p] < np.inf:
            options[count] = pack_option(cost[p], p)
            count += 1
    options[:count].sort()
    return count


@jit
def pack_option(cost: np.float32, p: int) -> int:
    """Pack an operation into one integer that sorts by cost: the bits of non-negative floats sort as the floats do."""
    return int((np.int64(np.float32(cost).view(np.int32)) << OPERATION_BITS) | p)


@jit
def _evaluate_tree(
    planning_view: PlanningView, agent: Array, passing: bool, wait: np.float32, tree: Operations, state: EpibtState
) -> None:
    """Compute the cell, heading and cost of every node from an agent's state; leaves' costs include the cost to go.

    A wait costs `wait` in every cell, the smallest cost of a wait. Operations that stop moving early end with waits in
    place of the turns for the next move, so with the costs of cells an agent might rather wait first, and forever,
    where waiting is cheaper. Waits do not cost more than turns, so that no agent turns around and around instead.
    """
    leads_to, weight = planning_view.leads_to, planning_view.weight
    cells, headings, cost, ends = state.node_cell, state.node_heading, state.node_cost, state.node_ends
    cells[0], headings[0], cost[0], ends[0] = agent.cell, agent.heading, 0.0, False
    for node in range(1, cells.size):
        before = tree.parent[node]
        cell, heading = cells[before], (headings[before] + tree.turn[node]) & 3
        step_cost = weight[WAIT_WEIGHT, cell] if tree.turn[node] else wait
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
def first_actions(agents: Array, tree: Operations, state: EpibtState, actions: Array) -> None:
    """Write each agent's first action (N,) int64, and store the state that it leads to."""
    for i in range(agents.size):
        node = tree.nodes[state.choice[i], 0]
        actions[i] = tree.action[node]
        state.cell[i] = state.path[i, state.choice[i], 1]
        state.heading[i] = (agents[i].heading + tree.turn[node]) % 4
