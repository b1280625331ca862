"""LaCAM: a depth-first search over the configurations of all agents, which rarely has to backtrack.

Okumura, *LaCAM: Search-Based Algorithm for Quick Multi-Agent Pathfinding*, AAAI 2023. A configuration is the cells of
all agents. PIBT generates its successors one at a time, each under different constraints "agent i goes to cell c". The
constraints come from a tree that eventually contains every combination, so the search is complete, given enough time
and memory.

The agents have no headings here. This also works for rotating agents: one step without headings takes at most three
steps with headings if all agents wait until all have turned, so the same instances are solvable. `lacam.schedule`
shortens these waits. (Ranking cells by the cost with turns shortens paths by less than a tenth on random maps, but
lengthens them by up to three quarters in warehouses, where agents that avoid turns meet in the same corridors.)
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapf_pz._internal.jit import Array, jit
from mapf_pz.planners.copying import copy_row
from mapf_pz.planners.hashing import find_slot, hash_row
from mapf_pz.planners.lacam.step import STAY, UNDECIDED, LacamScratch, draw, next_cells, outside

NONE = -1
RUNNING, SOLVED, EXHAUSTED, FULL = range(4)
"""Results of `search`. FULL means that `Nodes` or `Constraints` must grow."""

NUM_NODES, NUM_CONSTRAINTS, TOP, SOLUTION = range(4)
"""Indices of the counters (4,) int64: the numbers of nodes and constraints, the top of the stack, and the solution."""

_RESTART_INTERVAL = 1000
"""When a known configuration is found again, the search continues from the start with a probability of 1 in this many.

This lets it escape from dead ends (Okumura, *Improving LaCAM for Scalable Eventually Optimal Multi-Agent Pathfinding*,
IJCAI 2023).
"""


class Nodes(NamedTuple):
    """Up to K configurations of N agents. The open ones form a stack, as a doubly linked list."""

    rows: Array  # (K, N) int32: the cells; outside of the map for agents that disappear after this step
    order: Array  # (K, N) int32: the agents, the highest priority first
    parent: Array  # (K,) int32: the node before it; -1: none, it is the start
    key: Array  # (K,) uint64: the hash of the cells
    slots: Array  # (2 * K,) int32: hash table of nodes with open addressing; -1: empty
    above: Array  # (K,) int32: the neighbors in the stack; -1: none
    below: Array  # (K,) int32
    first: Array  # (K,) int32: the queue of untried constraints; -1: empty, so the node is not open
    last: Array  # (K,) int32


class Constraints(NamedTuple):
    """Up to K constraints."""

    cell: Array  # (K,) int32: the prescribed cell of the agent at index `depth - 1` of its node's order
    depth: Array  # (K,) int32: number of constrained agents, including those of `origin`; 0: none
    origin: Array  # (K,) int32: the constraint that this one extends
    after: Array  # (K,) int32: the next one in the queue; -1: none


def allocate_nodes(capacity: int, num_agents: int) -> Nodes:
    """Allocate K configurations of N agents."""
    return Nodes(
        rows=np.zeros((capacity, num_agents), np.int32),
        order=np.zeros((capacity, num_agents), np.int32),
        parent=np.zeros(capacity, np.int32),
        key=np.zeros(capacity, np.uint64),
        slots=np.full(2 * capacity, NONE, np.int32),
        above=np.zeros(capacity, np.int32),
        below=np.zeros(capacity, np.int32),
        first=np.zeros(capacity, np.int32),
        last=np.zeros(capacity, np.int32),
    )


def allocate_constraints(capacity: int) -> Constraints:
    """Allocate K constraints."""
    return Constraints(*(np.zeros(capacity, np.int32) for _ in range(4)))


@jit
def start(
    problem: Array, ends: Array, order: Array, nodes: Nodes, constraints: Constraints, scratch: LacamScratch,
    counters: Array
) -> int:  # fmt: skip
    """Open the first configuration. Return `SOLVED` if all agents are at their goals, else `RUNNING`.

    Args:
        problem: a `Problem` without headings.
        ends: (N,) int32, the cell on which each agent ends: its goal, or outside of the map; -1: anywhere.
        order: (N,) int32, the agents, the highest priority first.
        nodes: newly allocated.
        constraints: newly allocated.
        scratch: newly allocated.
        counters: (4,) int64.
    """
    counters[NUM_NODES] = counters[NUM_CONSTRAINTS] = 0
    counters[TOP] = counters[SOLUTION] = NONE
    copy_row(problem.starts, scratch.want)
    copy_row(order, nodes.order[0])
    key = hash_row(scratch.want)
    return _open(ends, NONE, key, find_slot(nodes, scratch.want, key), nodes, constraints, scratch, counters)


@jit
def search(
    problem: Array, ends: Array, iterations: int, nodes: Nodes, constraints: Constraints, scratch: LacamScratch,
    counters: Array
) -> int:  # fmt: skip
    """Continue the search for a number of iterations; return its status."""
    for _ in range(iterations):
        # An iteration adds at most one node with its empty constraint, and five constraints of the next agent.
        if counters[NUM_NODES] == nodes.parent.size or counters[NUM_CONSTRAINTS] + 6 > constraints.cell.size:
            return FULL
        # The high level of LaCAM (Okumura 2023), depth first: the latest configuration that has untried constraints.
        node = counters[TOP]
        if node == NONE:
            return EXHAUSTED
        # The low level, breadth first: the first constraint is empty, so plain PIBT is tried first, and only if the
        # search comes back are agents constrained, one more at each level of the tree.
        constraint = nodes.first[node]
        nodes.first[node] = constraints.after[constraint]
        if constraints.depth[constraint] < problem.goals.size:
            _grow(problem, node, constraint, nodes, constraints, scratch, counters)
        if nodes.first[node] == NONE:
            # All combinations of cells have been tried: no other successor is left.
            _unlink(nodes, counters, node)
        scratch.want[:] = UNDECIDED
        # The way from the constraint to the root of its tree prescribes a cell for each of the first `depth` agents.
        while constraints.depth[constraint] > 0:
            agent = nodes.order[node, constraints.depth[constraint] - 1]
            scratch.want[agent] = constraints.cell[constraint]
            constraint = constraints.origin[constraint]
        # PIBT is the configuration generator. If it fails, this constraint has no successor; the node stays open for
        # others.
        if not next_cells(problem, nodes.rows[node], nodes.order[node], scratch):
            continue
        if problem.disappear:
            _remove_arrived(problem, scratch.want)
        key = hash_row(scratch.want)
        slot = find_slot(nodes, scratch.want, key)
        known = nodes.slots[slot]
        # The hash table is the closed list: a configuration has one node, however it is reached.
        if known == NONE:
            if _open(ends, node, key, slot, nodes, constraints, scratch, counters) == SOLVED:
                return SOLVED
            _inherit(ends, counters[NUM_NODES] - 1, nodes)
            continue
        if draw(scratch.random) % np.uint64(_RESTART_INTERVAL) == 0:
            known = 0
        # Depth first also here: the search goes on from where it has arrived, if anything is left to try there.
        if nodes.first[known] != NONE:
            _unlink(nodes, counters, known)
            _push(nodes, counters, known)
    return RUNNING


@jit
def _remove_arrived(problem: Array, cells: Array) -> None:
    """Move agents at their goals outside of the map. They count as there from the step in which they arrive.

    In the first configuration they are not removed, as they have not arrived: so it differs from all later ones.
    """
    for i in range(cells.size):
        if cells[i] == problem.goals[i]:
            cells[i] = outside(problem)


@jit
def _open(
    ends: Array,
    parent: int,
    key: np.uint64,
    slot: np.uint64,
    nodes: Nodes,
    constraints: Constraints,
    scratch: LacamScratch,
    counters: Array,
) -> int:
    """Create a node from the cells in `scratch.want`; return `SOLVED` if all agents are at their ends."""
    node, constraint = counters[NUM_NODES], counters[NUM_CONSTRAINTS]
    counters[NUM_NODES] += 1
    counters[NUM_CONSTRAINTS] += 1
    copy_row(scratch.want, nodes.rows[node])
    nodes.parent[node] = parent
    nodes.key[node] = key
    nodes.slots[slot] = node
    nodes.first[node] = nodes.last[node] = constraint
    constraints.depth[constraint] = 0
    constraints.after[constraint] = NONE
    _push(nodes, counters, node)
    for i in range(ends.size):
        # The first solution is taken, whatever its cost: a later step shortens the paths.
        if _away(scratch.want[i], ends[i]):
            return RUNNING
    counters[SOLUTION] = node
    return SOLVED


@jit
def _inherit(ends: Array, node: int, nodes: Nodes) -> None:
    """Set the order of a node's agents: first those away from their ends, in the parent's order, then the others.

    So an agent's priority grows with the time that it is away. The others keep the order of the first node.
    """
    parent, cells, order = nodes.parent[node], nodes.rows[node], nodes.order[node]
    position = 0
    # As in PIBT, whose guarantee that each agent reaches its goal at some time rests on these priorities.
    for i in nodes.order[parent]:
        if _away(cells[i], ends[i]):
            order[position] = i
            position += 1
    for i in nodes.order[0]:
        if not _away(cells[i], ends[i]):
            order[position] = i
            position += 1


@jit
def _away(cell: int, end: int) -> bool:
    return end != NONE and cell != end


@jit
def _grow(
    problem: Array,
    node: int,
    origin: int,
    nodes: Nodes,
    constraints: Constraints,
    scratch: LacamScratch,
    counters: Array,
) -> None:
    """Append the constraints of one more agent to the node's queue, in random order."""
    depth = constraints.depth[origin] + 1
    agent = nodes.order[node, depth - 1]
    leads_to, cell, choices = problem.leads_to, nodes.rows[node, agent], scratch.choices[agent]
    if cell == outside(problem):
        return  # the agents after it in the order have disappeared, too: nothing is left to constrain
    for k in range(5):
        # Shuffled (Fisher and Yates), so that no direction is preferred.
        other = int(draw(scratch.random) % np.uint64(k + 1))
        choices[k] = choices[other]
        choices[other] = k
    for choice in choices:
        target = cell if choice == STAY else leads_to[choice, cell]
        if choice != STAY and target == cell:
            continue
        constraint = counters[NUM_CONSTRAINTS]
        counters[NUM_CONSTRAINTS] += 1
        constraints.cell[constraint] = target
        constraints.depth[constraint] = depth
        constraints.origin[constraint] = origin
        constraints.after[constraint] = NONE
        if nodes.first[node] == NONE:
            # At the end of the queue, so that the tree is searched level by level.
            nodes.first[node] = constraint
        else:
            constraints.after[nodes.last[node]] = constraint
        nodes.last[node] = constraint


@jit
def _push(nodes: Nodes, counters: Array, node: int) -> None:
    top = counters[TOP]
    nodes.above[node], nodes.below[node] = NONE, top
    if top != NONE:
        nodes.above[top] = node
    counters[TOP] = node


@jit
def _unlink(nodes: Nodes, counters: Array, node: int) -> None:
    above, below = nodes.above[node], nodes.below[node]
    if above == NONE:
        counters[TOP] = below
    else:
        nodes.below[above] = below
    if below != NONE:
        nodes.above[below] = above
