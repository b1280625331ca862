"""Cost to go: the cheapest weighted cost from every cell and heading to a goal, rotations included.

`D(s) = min_a [c(s, a) + D(s')]` with `D(goal, any heading) = 0`, found backwards from the goal: breadth first where all
weights are equal, by Dijkstra's algorithm otherwise. A state is the number `cell * D + heading`, with `D = 4` headings,
or 1 for cardinal agents.
"""

from __future__ import annotations

import numpy as np
from numba import prange

from mapf_pz.actions import Action
from mapf_pz.core.conflict import NO_MOVE, direction
from mapf_pz.core.jit import BatchKernel, jit
from mapf_pz.core.state import WAIT_WEIGHT, Array, Distances, World

_LEFT, _RIGHT = int(Action.ROTATE_LEFT), int(Action.ROTATE_RIGHT)
_STRAIGHT_RIGHT_LEFT_BACK = ((0, 0), (1, 1), (3, 1), (2, 2))  # (turn to the right, number of turns it takes)


@BatchKernel
def fill_tables(world: World, maps: Array, goals: Array, slots: Array, distances: Distances, scratch: Array) -> None:
    """Fill table `slots[k]` with the cost to go to `goals[k]` on map `maps[k]`.

    `scratch` (T, 2, (C + 1) * D) int32 holds a queue or heap for each of T chunks of the work.
    """
    chunks = scratch.shape[0]
    for chunk in prange(chunks):
        for k in range(chunk, goals.size, chunks):
            m, slot = maps[k], slots[k]
            cost_to_go(world, m, goals[k], world.equal_weight[m], distances.to_go[slot], scratch[chunk])
            _find_nearest(distances.to_go[slot], distances.nearest[slot])


@jit
def _find_nearest(to_go: Array, nearest: Array) -> None:
    for cell in range(nearest.size):
        nearest[cell] = np.inf
        for heading in range(to_go.shape[1]):
            nearest[cell] = min(nearest[cell], to_go[cell, heading])


@jit
def cost_to_go(world: World, m: int, goal: int, equal_weight: float, to_go: Array, scratch: Array) -> None:
    """Fill `to_go` (C + 1, D) float32 for map `m`; an `equal_weight` other than 0 stands for all weights."""
    to_go[:] = np.inf
    if equal_weight > 0:
        _breadth_first(world.leads_to[m], goal, equal_weight, to_go, scratch[0])
    else:
        _dijkstra(world, m, goal, to_go.reshape(-1), to_go.shape[1], scratch[0], scratch[1])


@jit
def _breadth_first(leads_to: Array, goal: int, weight: float, to_go: Array, queue: Array) -> None:
    if to_go.shape[1] == 1:
        _flood(leads_to, goal, weight, to_go[:, 0], queue)
    else:
        _flood_turning(leads_to, goal, weight, to_go, queue)


@jit
def _flood(leads_to: Array, goal: int, weight: float, to_go: Array, queue: Array) -> None:
    """Fill `to_go` (C + 1,), infinite before, for agents without headings."""
    to_go[goal], queue[0] = 0, goal
    head, tail = 0, 1
    while head < tail:
        cell = queue[head]
        head += 1
        cost = to_go[cell] + weight
        for d in range(4):
            # Free cells are joined both ways, so the way back leads to the cell that a move would come from.
            before = leads_to[d, cell]
            if to_go[before] == np.inf:
                to_go[before], queue[tail] = cost, before
                tail += 1


@jit
def _flood_turning(leads_to: Array, goal: int, weight: float, to_go: Array, queue: Array) -> None:
    """Fill `to_go` (C + 1, 4), infinite before; the queue holds `4 * cell + heading`."""
    for heading in range(4):
        to_go[goal, heading], queue[heading] = 0, 4 * goal + heading
    head, tail = 0, 4
    while head < tail:
        cell, heading = queue[head] >> 2, queue[head] & 3
        head += 1
        cost = to_go[cell, heading] + weight
        before = leads_to[heading ^ 2, cell]  # behind it
        if to_go[before, heading] == np.inf:
            to_go[before, heading], queue[tail] = cost, 4 * before + heading
            tail += 1
        for turned in ((heading + 1) & 3, (heading + 3) & 3):
            if to_go[cell, turned] == np.inf:
                to_go[cell, turned], queue[tail] = cost, 4 * cell + turned
                tail += 1


@jit
def _dijkstra(world: World, m: int, goal: int, cost: Array, headings: int, heap: Array, place: Array) -> None:
    """Fill the flat `cost` ((C + 1) * D,) with the help of a binary heap and each state's place in it."""
    place[: cost.size] = -1
    size = 0
    for heading in range(headings):
        size = _lower(cost, heap, place, size, goal * headings + heading, 0.0)
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
                size = _lower(cost, heap, place, size, before * headings + heading, price)
        if headings == 4:
            for turn in (1, 3):
                price = cost[state] + world.weight[m, WAIT_WEIGHT, cell]
                size = _lower(cost, heap, place, size, cell * 4 + (heading + turn) % 4, price)


@jit
def _lower(cost: Array, heap: Array, place: Array, size: int, state: int, price: float) -> int:
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


def shortest_lengths(world: World, m: int, starts: Array, headings: Array, goals: Array, num_headings: int) -> Array:
    """Return the length in steps (N,) int32 of each agent's shortest path on map `m`, without other agents; -1: none.

    `starts`, `headings` and `goals` are (N,); `num_headings` is 4, or 1 for cardinal agents.
    """
    cells = world.obstacle.shape[1]
    to_go = np.empty((cells, num_headings), np.float32)
    scratch = np.empty((2, cells * num_headings), np.int32)
    lengths = np.empty(goals.size, np.int32)
    order = np.argsort(goals, kind="stable")
    _shortest_lengths(world, m, starts[order], headings[order], goals[order], to_go, scratch, lengths)
    return lengths[np.argsort(order)]


@jit
def _shortest_lengths(
    world: World, m: int, starts: Array, headings: Array, goals: Array, to_go: Array, scratch: Array, steps: Array
) -> None:
    """Write the lengths to `steps` (N,); agents with the same goal follow each other.

    `to_go` (C + 1, D) float32 and `scratch` (2, (C + 1) * D) int32 are scratch.
    """
    for i in range(goals.size):
        if i == 0 or goals[i] != goals[i - 1]:
            cost_to_go(world, m, goals[i], 1.0, to_go, scratch)
        length = to_go[starts[i], headings[i] % to_go.shape[1]]
        steps[i] = length if length < np.inf else -1


@jit
def turned(heading: int, action: int) -> int:
    """Return the heading after `action` of the rotating model."""
    if action == _LEFT:
        return (heading + 3) % 4
    if action == _RIGHT:
        return (heading + 1) % 4
    return heading


@jit
def advantage(
    leads_to: Array, weight: Array, mean_weight: float, to_go: Array, cardinal: bool, agent: Array, action: int
) -> float:
    """Return `clip((D - c(action) - D') / mean weight, -2, 0) / 2`: 0 for the best action, -1 for a blocked one.

    `leads_to`, `weight` and `mean_weight` are those of one map, `to_go` (C + 1, D) the agent's table.
    """
    cell, heading = agent.cell, agent.heading
    towards = direction(cardinal, heading, action)
    facing = heading & (to_go.shape[1] - 1)  # D is 1 or 4, and to divide by it takes longer than all else
    own = to_go[cell, facing]
    if own == np.inf:
        return -1.0
    if towards != NO_MOVE:  # a blocked move costs infinitely much
        after = weight[towards, cell] + to_go[leads_to[towards, cell], facing]
    elif cardinal or turned(heading, action) == heading:
        after = own + (0.0 if cell == agent.goal else weight[WAIT_WEIGHT, cell])  # resting on the goal is free
    else:
        after = weight[WAIT_WEIGHT, cell] + to_go[cell, turned(heading, action)]
    return min(max((own - after) / mean_weight, -2.0), 0.0) / 2


@jit
def next_cell(leads_to: Array, weight: Array, to_go: Array, cell: int, heading: int) -> int:
    """Return the next other cell on the cheapest path to the goal, or -1 on the goal and where there is no path.

    Of equal paths, the one that begins straight ahead comes first, then right, left, back (cardinal: east, south, west,
    north).
    """
    rotates = to_go.shape[1] == 4
    best, best_cost = -1, np.inf
    if to_go[cell, heading & (to_go.shape[1] - 1)] == 0:
        return best
    for k in range(4):
        turn, turns = _STRAIGHT_RIGHT_LEFT_BACK[k]
        towards = (heading + turn) % 4 if rotates else k
        target = leads_to[towards, cell]
        cost = weight[towards, cell] + to_go[target, towards & (to_go.shape[1] - 1)]
        if rotates:
            cost += turns * weight[WAIT_WEIGHT, cell]
        if cost < best_cost:
            best, best_cost = target, cost
    return best
