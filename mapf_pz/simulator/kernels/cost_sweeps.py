"""Cost to go to many goals of one map at once, by sweeps over its cells.

A table of one goal by Dijkstra's algorithm spends most of its time in the heap. Here, `LANES` goals are computed
together by value iteration in place: cells are visited in breadth-first order and back, and each visit lowers the costs
of a cell for all goals with vector instructions. Cells none of whose neighbors has changed are skipped. The costs are
those of Dijkstra's algorithm to the bit, as both find the least solution of `D(s) = min_a [c(s, a) + D(s')]`.

Cells are numbered by breadth-first search, so that memory holds only cells that can be reached, neighbors close
together; a state is `D * number + heading`.
"""

from __future__ import annotations

import numpy as np
from numba import prange

from mapf_pz._internal.jit import Array, BatchKernel, jit
from mapf_pz.simulator.kernels.state import WAIT_WEIGHT, Distances, World

LANES = 32
"""Number of goals that are computed together."""
FEWEST_GOALS = 16
"""Number of goals from which on sweeps are faster than Dijkstra's algorithm."""
_TILE = 32


def fill_by_sweeps(num_threads: int, world: World, m: int, goals: Array, slots: Array, distances: Distances) -> None:
    """Fill table `slots[k]` with the cost to go to `goals[k]` on map `m`; goals should be sorted by cell."""
    cells = world.obstacle.shape[1]
    order, number = np.empty(cells, np.int32), np.full(cells, -1, np.int32)
    count = _breadth_first_order(world.leads_to[m], goals, order, number)
    leads_to, weight = _renumbered(world.leads_to[m], world.weight[m], order[:count], number)
    num_headings = distances.exact.shape[2]
    num_blocks = -(-goals.size // LANES)
    chunks = min(num_threads, num_blocks)
    costs = np.empty((chunks, count * num_headings, LANES), np.float32)
    lowered = np.empty((chunks, 2 * num_headings, LANES), np.float32)
    dirty = np.zeros((chunks, count), np.bool_)
    _fill(num_threads, leads_to, weight, order[:count], number, goals, slots, distances, costs, lowered, dirty)


@jit
def _breadth_first_order(leads_to: Array, goals: Array, order: Array, number: Array) -> int:
    """Write the cells that can reach a goal to `order`, and their places in it to `number` (-1 before); count them."""
    tail = 0
    for goal in goals:
        if number[goal] >= 0:
            continue
        head = tail
        order[tail], number[goal] = goal, tail
        tail += 1
        while head < tail:
            cell = order[head]
            head += 1
            for d in range(4):
                near = leads_to[d, cell]
                if number[near] < 0:
                    order[tail], number[near] = near, tail
                    tail += 1
    return tail


@jit
def _renumbered(leads_to: Array, weight: Array, order: Array, number: Array) -> tuple[Array, Array]:
    """Return `leads_to` (n, 4) and `weight` (n, 5) of the cells `order` (n,), by their numbers."""
    near, price = np.empty((order.size, 4), np.int32), np.empty((order.size, 5), np.float32)
    for k in range(order.size):
        for d in range(4):
            near[k, d] = number[leads_to[d, order[k]]]
        for d in range(5):
            price[k, d] = weight[d, order[k]]
    return near, price


@BatchKernel
def _fill(
    leads_to: Array, weight: Array, order: Array, number: Array, goals: Array, slots: Array, distances: Distances,
    costs: Array, lowered: Array, dirty: Array
) -> None:  # fmt: skip
    """Fill all tables, in blocks of `LANES`; `costs`, `lowered` and `dirty` are scratch for each chunk of the work."""
    chunks = costs.shape[0]
    for chunk in prange(chunks):
        for first in range(chunk * LANES, goals.size, chunks * LANES):
            last = min(first + LANES, goals.size)
            _start(leads_to, number, goals[first:last], costs[chunk], dirty[chunk])
            _sweep(leads_to, weight, costs[chunk], lowered[chunk], dirty[chunk])
            _copy(costs[chunk], order, slots[first:last], distances)


@jit
def _start(leads_to: Array, number: Array, goals: Array, costs: Array, dirty: Array) -> None:
    """Set all costs to infinity, and those at the goals to 0."""
    headings = costs.shape[0] // leads_to.shape[0]
    costs[:] = np.inf
    for lane in range(goals.size):
        goal = number[goals[lane]]
        for heading in range(headings):
            costs[goal * headings + heading, lane] = 0
        for d in range(4):
            dirty[leads_to[goal, d]] = True


@jit
def _sweep(leads_to: Array, weight: Array, costs: Array, lowered: Array, dirty: Array) -> None:
    """Visit the cells in their order and back until nothing changes."""
    changed, count = True, leads_to.shape[0]
    turns = costs.shape[0] > count
    backwards = False
    while changed:
        changed = False
        for k in range(count):
            cell = count - 1 - k if backwards else k
            if not dirty[cell]:
                continue
            dirty[cell] = False
            is_lower = (
                _lower_turning(leads_to[cell], weight[cell], costs, cell, lowered)
                if turns
                else _lower(leads_to[cell], weight[cell], costs, cell, lowered[0])
            )
            if is_lower:
                changed = True
                for d in range(4):
                    dirty[leads_to[cell, d]] = True
        backwards = not backwards


@jit
def _lower(leads_to: Array, weight: Array, costs: Array, cell: int, lowered: Array) -> bool:
    """Lower the costs of a cell; return whether any has changed. Blocked moves lead to the cell, at infinite cost."""
    # One expression of all neighbors, without branches, which becomes vector instructions.
    own, near = costs[cell], leads_to
    first, second, third, fourth = costs[near[0]], costs[near[1]], costs[near[2]], costs[near[3]]
    w0, w1, w2, w3 = weight[0], weight[1], weight[2], weight[3]
    for lane in range(lowered.size):
        one = min(first[lane] + w0, second[lane] + w1)
        other = min(third[lane] + w2, fourth[lane] + w3)
        lowered[lane] = min(min(one, other), own[lane])
    return _update(own, lowered)


@jit
def _lower_turning(leads_to: Array, weight: Array, costs: Array, cell: int, lowered: Array) -> bool:
    """Lower the costs of all four headings in a cell: by moving forward, then by up to two turns."""
    wait, changed = weight[WAIT_WEIGHT], False
    for heading in range(4):
        _lower_moving(
            costs[4 * leads_to[heading] + heading], weight[heading], costs[4 * cell + heading], lowered[heading]
        )
    for source, target in ((0, 4), (4, 0)):
        for heading in range(4):
            left, right = lowered[source + ((heading + 3) & 3)], lowered[source + ((heading + 1) & 3)]
            _lower_by_turn(lowered[source + heading], left, right, wait, lowered[target + heading])
    for heading in range(4):
        changed |= _update(costs[4 * cell + heading], lowered[heading])
    return changed


@jit
def _lower_moving(ahead: Array, price: float, own: Array, lowered: Array) -> None:
    for lane in range(lowered.size):
        lowered[lane] = min(ahead[lane] + price, own[lane])


@jit
def _lower_by_turn(own: Array, left: Array, right: Array, wait: float, lowered: Array) -> None:
    for lane in range(lowered.size):
        lowered[lane] = min(min(left[lane], right[lane]) + wait, own[lane])


@jit
def _update(costs: Array, lowered: Array) -> bool:
    """Copy `lowered` (LANES,) to the costs (LANES,) of a state; return whether any is lower."""
    count = 0
    for lane in range(lowered.size):
        count += lowered[lane] < costs[lane]
    if count == 0:
        return False
    for lane in range(lowered.size):
        costs[lane] = lowered[lane]
    return True


@jit
def _copy(costs: Array, order: Array, slots: Array, distances: Distances) -> None:
    """Copy the costs to the goals' tables, which are not packed."""
    headings = distances.exact.shape[2]
    for slot in slots:
        distances.exact[slot] = np.inf
        distances.least[slot] = np.inf
    for first in range(0, order.size, _TILE):  # in tiles of cells, since both arrays are larger than the cache
        for lane in range(slots.size):
            to_go, least = distances.exact[slots[lane]], distances.least[slots[lane]]
            for k in range(first, min(first + _TILE, order.size)):
                for heading in range(headings):
                    cost = costs[k * headings + heading, lane]
                    to_go[order[k], heading] = cost
                    least[order[k]] = min(least[order[k]], cost)
