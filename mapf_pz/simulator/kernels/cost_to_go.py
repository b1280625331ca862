"""Cost to go: the cheapest weighted cost from every cell and heading to a goal, rotations included.

`D(s) = min_a [c(s, a) + D(s')]` with `D(goal, any heading) = 0`, found backwards from the goal: breadth first where all
weights are equal, by Dijkstra's algorithm otherwise. A state is the number `cell * D + heading`, with `D = 4` headings,
or 1 for cardinal agents.
"""

from __future__ import annotations

import numpy as np
from numba import prange

from mapf_pz._internal.jit import Array, BatchKernel, jit
from mapf_pz.simulator.kernels.cost_lookup import ALL_EXCESS, LEAST_BIT, UNREACHABLE, unpack, unpack_steps
from mapf_pz.simulator.kernels.state import WAIT_WEIGHT, Distances, World

_UNKNOWN = 3
"""The excess of a heading that was not reached yet; the others differ by at most two turns."""


@BatchKernel
def fill_tables(world: World, maps: Array, goals: Array, slots: Array, distances: Distances, scratch: Array) -> None:
    """Fill table `slots[k]` with the cost to go to `goals[k]` on map `maps[k]`.

    `scratch` (T, 2, (C + 1) * D) int32 holds a queue or heap for each of T chunks of the work.
    """
    chunks = scratch.shape[0]
    for chunk in prange(chunks):
        for k in range(chunk, goals.size, chunks):
            _fill_table(world, maps[k], goals[k], slots[k], distances, scratch[chunk])


@jit
def _fill_table(world: World, m: int, goal: int, slot: int, distances: Distances, scratch: Array) -> None:
    headings, weight = distances.exact.shape[2], world.equal_weight[m]
    if distances.packed.shape[0] > 0:
        count_steps(world.leads_to[m], goal, headings, distances.packed[slot], scratch[0])
        return
    if weight > 0:
        steps = scratch[1, : world.leads_to.shape[2]].view(np.uint32)
        count_steps(world.leads_to[m], goal, headings, steps, scratch[0])
        for cell in range(steps.size):
            for heading in range(headings):
                distances.exact[slot, cell, heading] = weight * unpack(steps[cell], heading)
    else:
        distances.exact[slot] = np.inf
        _dijkstra(world, m, goal, distances.exact[slot].reshape(-1), headings, scratch[0], scratch[1])
    for cell in range(distances.least.shape[1]):
        least = distances.exact[slot, cell, 0]
        for heading in range(1, headings):
            least = min(least, distances.exact[slot, cell, heading])
        distances.least[slot, cell] = least


@jit
def count_steps(leads_to: Array, goal: int, headings: int, steps: Array, queue: Array) -> None:
    """Fill `steps` (C + 1,) uint32, packed, by breadth-first search; `queue` ((C + 1) * D,) int32 is scratch."""
    steps[:] = UNREACHABLE
    if headings == 1:
        _flood(leads_to, goal, steps, queue)
    else:
        _flood_turning(leads_to, goal, steps, queue)


@jit
def _flood(leads_to: Array, goal: int, steps: Array, queue: Array) -> None:
    """Fill `steps` for agents without headings."""
    steps[goal], queue[0] = 0, goal
    head, tail = 0, 1
    while head < tail:
        cell = queue[head]
        head += 1
        following = np.uint32(steps[cell] + (1 << LEAST_BIT))
        for d in range(4):
            # Free cells are joined both ways, so the way back leads to the cell that a move would come from.
            before = leads_to[d, cell]
            if steps[before] == UNREACHABLE:
                steps[before], queue[tail] = following, before
                tail += 1


@jit
def _flood_turning(leads_to: Array, goal: int, steps: Array, queue: Array) -> None:
    """Fill `steps` for agents that turn; the queue holds `4 * cell + heading`."""
    steps[goal] = 0
    for heading in range(4):
        queue[heading] = 4 * goal + heading
    head, tail = 0, 4
    while head < tail:
        cell, heading = queue[head] >> 2, queue[head] & 3
        head += 1
        following = unpack_steps(steps[cell], heading) + 1
        tail = _reach(leads_to[heading ^ 2, cell], heading, following, steps, queue, tail)  # from behind
        tail = _reach(cell, (heading + 1) & 3, following, steps, queue, tail)
        tail = _reach(cell, (heading + 3) & 3, following, steps, queue, tail)


@jit
def _reach(cell: int, heading: int, count: int, steps: Array, queue: Array, tail: int) -> int:
    """Set the steps from a cell and heading unless they are known; return the new end of the queue."""
    packed, bit = np.int64(steps[cell]), 2 * heading
    if packed >> bit & 3 != _UNKNOWN:
        return tail
    if packed == UNREACHABLE:
        packed = count << LEAST_BIT | ALL_EXCESS
    steps[cell] = np.uint32(packed & ~(_UNKNOWN << bit) | (count - (packed >> LEAST_BIT)) << bit)
    queue[tail] = 4 * cell + heading
    return tail + 1


@jit
def _dijkstra(world: World, m: int, goal: int, cost: Array, headings: int, heap: Array, place: Array) -> None:
    """Fill the flat `cost` ((C + 1) * D,) with the help of a binary heap and each state's place in it."""
    place[: cost.size] = -1
    size = 0
    for heading in range(headings):
        size = lower(cost, heap, place, size, goal * headings + heading, 0.0)
    settle(world, m, cost, headings, heap, place, size)


@jit
def settle(world: World, m: int, cost: Array, headings: int, heap: Array, place: Array, size: int) -> None:
    """Lower the costs of all states by those of the `size` states in the heap."""
    while size > 0:
        state = heap[0]
        size = _pop(cost, heap, place, size)
        cell, heading = divmod(state, headings)
        for d in range(4):
            if headings == 4 and d != heading:
                continue
            before = world.leads_to[m, (d + 2) % 4, cell]
            if before != cell:
                price = cost[state] + world.weight[m, d, before]
                size = lower(cost, heap, place, size, before * headings + heading, price)
        if headings == 4:
            for turn in (1, 3):
                price = cost[state] + world.weight[m, WAIT_WEIGHT, cell]
                size = lower(cost, heap, place, size, cell * 4 + (heading + turn) % 4, price)


@jit
def lower(cost: Array, heap: Array, place: Array, size: int, state: int, price: float) -> int:
    """Lower the cost of `state` to `price` if that is cheaper; return the heap's new size."""
    if np.float32(price) >= cost[state]:
        return size
    cost[state] = price
    child = place[state]
    if child < 0:
        child = size
        size += 1
    while child > 0:
        parent = (child - 1) // 2
        if cost[heap[parent]] <= cost[state]:
            break
        heap[child] = heap[parent]
        place[heap[child]] = child
        child = parent
    heap[child] = state
    place[state] = child
    return size


@jit
def _pop(cost: Array, heap: Array, place: Array, size: int) -> int:
    """Remove the cheapest state; return the heap's new size."""
    size -= 1
    last = heap[size]
    parent = 0
    while True:
        child = 2 * parent + 1
        if child >= size:
            break
        if child + 1 < size and cost[heap[child + 1]] < cost[heap[child]]:
            child += 1
        if cost[last] <= cost[heap[child]]:
            break
        heap[parent] = heap[child]
        place[heap[parent]] = parent
        parent = child
    heap[parent] = last
    place[last] = parent
    return size
