"""LaCAM: a search over the configurations of all agents, depth first, that seldom has to look at more than one path.

Okumura, *LaCAM: Search-Based Algorithm for Quick Multi-Agent Pathfinding*, AAAI 2023. A configuration says where each
agent is. Its successors are made one at a time, by PIBT, each under other constraints "agent i goes to cell c". These
are drawn from a tree that prescribes every combination in the end, so the search finds a plan whenever there is one,
given time and room.

The agents have no headings here. That serves those that turn as well: what the others do in one step they do in three
at most, if all wait until everyone looks where it goes; so both can solve the same instances. `lacam_schedule` lets
them wait less. (Ranking cells by the cost with turns shortens paths by less than a tenth on random maps, but lengthens
them by up to three quarters in warehouses, where agents that avoid turns meet in the same corridors.)
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapf_pz.core.jit import jit
from mapf_pz.core.state import Array
from mapf_pz.planners.lacam.step import STAY, UNDECIDED, LacamScratch, draw, next_cells

NONE = -1
RUNNING, SOLVED, EXHAUSTED, FULL = range(4)
"""What `search` ends with: FULL calls for larger `Nodes` and `Constraints`."""

NUM_NODES, NUM_CONSTRAINTS, TOP, SOLUTION = range(4)
"""What is in the counters (4,) int64: how many there are, the node on top of the stack, and the one that solves it."""

_STARTS_OVER = 1000
"""Once in so many times that a known configuration is found again, the search goes on from the start instead.

That gets it out of where it leads nowhere (Okumura, *Improving LaCAM for Scalable Eventually Optimal Multi-Agent
Pathfinding*, IJCAI 2023).
"""


class Nodes(NamedTuple):
    """Room for K configurations of N agents. Those that are still open form a stack, linked both ways."""

    cells: Array  # (K, N) int32
    order: Array  # (K, N) int32: the agents, the highest priority first
    parent: Array  # (K,) int32: -1: the start
    key: Array  # (K,) uint64: the hash of the cells
    slots: Array  # (2 * K,) int32: nodes by their keys, with open addressing; -1: empty
    above: Array  # (K,) int32: the neighbours in the stack; -1: none
    below: Array  # (K,) int32
    first: Array  # (K,) int32: the queue of constraints that are still to be tried; -1: none, then it is not open
    last: Array  # (K,) int32


class Constraints(NamedTuple):
    """Room for K constraints."""

    cell: Array  # (K,) int32: where the agent goes that comes at place `depth - 1` of its node's order
    depth: Array  # (K,) int32: how many agents are constrained, those of `origin` among them; 0: none
    origin: Array  # (K,) int32
    after: Array  # (K,) int32: the next one in the queue; -1: none


def allocate_nodes(room: int, num_agents: int) -> Nodes:
    """Make room for K configurations of N agents."""
    return Nodes(
        cells=np.zeros((room, num_agents), np.int32),
        order=np.zeros((room, num_agents), np.int32),
        parent=np.zeros(room, np.int32),
        key=np.zeros(room, np.uint64),
        slots=np.full(2 * room, NONE, np.int32),
        above=np.zeros(room, np.int32),
        below=np.zeros(room, np.int32),
        first=np.zeros(room, np.int32),
        last=np.zeros(room, np.int32),
    )


def allocate_constraints(room: int) -> Constraints:
    """Make room for K constraints."""
    return Constraints(*(np.zeros(room, np.int32) for _ in range(4)))


@jit
def begin(
    problem: Array, order: Array, nodes: Nodes, constraints: Constraints, scratch: LacamScratch, counters: Array
) -> int:
    """Open the start; return `SOLVED` if all agents are at their goals, else `RUNNING`.

    Args:
        problem: a `Problem` of the planners, without headings; an agent with the goal -1 may be anywhere in the end.
        order: (N,) int32, the agents, the highest priority first.
        nodes: new.
        constraints: new.
        scratch: new, of `lacam_step`.
        counters: (4,) int64.
    """
    counters[NUM_NODES] = counters[NUM_CONSTRAINTS] = 0
    counters[TOP] = counters[SOLUTION] = NONE
    scratch.want[:] = problem.starts
    nodes.order[0] = order
    key = _hash(scratch.want)
    return _open(problem.goals, NONE, key, _find(nodes, scratch.want, key), nodes, constraints, scratch, counters)


@jit
def search(
    problem: Array, iterations: int, nodes: Nodes, constraints: Constraints, scratch: LacamScratch, counters: Array
) -> int:
    """Go on with what `begin` began, for so many iterations; return how it stands."""
    for _ in range(iterations):
        if counters[NUM_NODES] == nodes.parent.size or counters[NUM_CONSTRAINTS] + 6 > constraints.cell.size:
            return FULL
        node = counters[TOP]
        if node == NONE:
            return EXHAUSTED
        constraint = nodes.first[node]
        nodes.first[node] = constraints.after[constraint]
        if constraints.depth[constraint] < problem.goals.size:
            _grow(problem.leads_to, node, constraint, nodes, constraints, scratch, counters)
        if nodes.first[node] == NONE:
            _unlink(nodes, counters, node)
        scratch.want[:] = UNDECIDED
        while constraints.depth[constraint] > 0:
            agent = nodes.order[node, constraints.depth[constraint] - 1]
            scratch.want[agent] = constraints.cell[constraint]
            constraint = constraints.origin[constraint]
        if not next_cells(problem, nodes.cells[node], nodes.order[node], scratch):
            continue
        key = _hash(scratch.want)
        slot = _find(nodes, scratch.want, key)
        known = nodes.slots[slot]
        if known == NONE:
            if _open(problem.goals, node, key, slot, nodes, constraints, scratch, counters) == SOLVED:
                return SOLVED
            _inherit(problem.goals, counters[NUM_NODES] - 1, nodes)
            continue
        if draw(scratch.random) % np.uint64(_STARTS_OVER) == 0:
            known = 0
        if nodes.first[known] != NONE:
            _unlink(nodes, counters, known)
            _push(nodes, counters, known)
    return RUNNING


@jit
def _open(
    goals: Array,
    parent: int,
    key: int,
    slot: int,
    nodes: Nodes,
    constraints: Constraints,
    scratch: LacamScratch,
    counters: Array,
) -> int:
    """Make a node of the cells in `scratch.want`; return `SOLVED` if all agents are at their goals there."""
    node, constraint = counters[NUM_NODES], counters[NUM_CONSTRAINTS]
    counters[NUM_NODES] += 1
    counters[NUM_CONSTRAINTS] += 1
    nodes.cells[node] = scratch.want
    nodes.parent[node] = parent
    nodes.key[node] = key
    nodes.slots[slot] = node
    nodes.first[node] = nodes.last[node] = constraint
    constraints.depth[constraint] = 0
    constraints.after[constraint] = NONE
    _push(nodes, counters, node)
    for i in range(goals.size):
        if _away(scratch.want[i], goals[i]):
            return RUNNING
    counters[SOLUTION] = node
    return SOLVED


@jit
def _inherit(goals: Array, node: int, nodes: Nodes) -> None:
    """Order a node's agents: those away from their goals as in its parent, where new ones come last, then the others.

    So the longer an agent is away, the higher is its priority. The others keep the order of the first node.
    """
    parent, cells, order = nodes.parent[node], nodes.cells[node], nodes.order[node]
    place = 0
    for i in nodes.order[parent]:
        if _away(cells[i], goals[i]):
            order[place] = i
            place += 1
    for i in nodes.order[0]:
        if not _away(cells[i], goals[i]):
            order[place] = i
            place += 1


@jit
def _away(cell: int, goal: int) -> bool:
    return goal != NONE and cell != goal


@jit
def _grow(
    leads_to: Array,
    node: int,
    origin: int,
    nodes: Nodes,
    constraints: Constraints,
    scratch: LacamScratch,
    counters: Array,
) -> None:
    """Put the constraints of one more agent into the node's queue, in random order."""
    depth = constraints.depth[origin] + 1
    agent = nodes.order[node, depth - 1]
    cell, choices = nodes.cells[node, agent], scratch.choices[agent]
    for k in range(5):
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


@jit
def refill_slots(nodes: Nodes, counters: Array) -> None:
    """Enter all nodes into `nodes.slots` anew, after its size has changed."""
    nodes.slots[:] = NONE
    for node in range(counters[NUM_NODES]):
        nodes.slots[_find(nodes, nodes.cells[node], nodes.key[node])] = node


@jit
def _hash(cells: Array) -> int:
    """Return 64 bits, unsigned, that depend on all cells (FNV-1a, a cell at a time)."""
    key = np.uint64(14695981039346656037)
    for cell in cells:
        key = (key ^ np.uint64(cell)) * np.uint64(1099511628211)
    return key ^ (key >> np.uint64(32))


@jit
def _find(nodes: Nodes, cells: Array, key: int) -> int:
    """Return the slot of the node with these cells, or the empty one that it would get."""
    size = np.uint64(nodes.slots.size)
    slot = key % size
    while True:
        node = nodes.slots[slot]
        if node == NONE or (nodes.key[node] == key and _equal(nodes.cells[node], cells)):
            return slot
        slot = (slot + np.uint64(1)) % size


@jit
def _equal(one: Array, other: Array) -> bool:
    i = 0  # np.array_equal takes long to compile
    while i < one.size and one[i] == other[i]:
        i += 1
    return i == one.size
