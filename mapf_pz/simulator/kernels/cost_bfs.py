"""Cost to go to eight goals of one small map at once, where all weights are equal.

One breadth-first search for each goal runs in the bits of bytes (Then et al., *The More the Merrier*, VLDB 2014): a
plane has a byte for each cell, and bit `k` belongs to goal `k`. A step of all searches is a few operations on whole
planes, which become vector instructions; a search with a queue visits one state after another.

Planes have a row more above and below the map, and a column more on its right, which no search reaches.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import prange

from mapf_pz._internal.jit import Array, BatchKernel, inlined, jit
from mapf_pz.simulator.kernels.cost_lookup import LEAST_BIT, UNREACHABLE
from mapf_pz.simulator.kernels.state import Distances, World
from mapf_pz.simulator.kernels.world import STEPS

LANES = 8
"""Number of goals that are searched from together."""
FEWEST_GOALS = 4
"""Number of goals from which on this is faster than searches with a queue."""
MOST_CELLS = 2**13
"""Size of a map up to which this is faster. No path is longer than `4 * MOST_CELLS` steps, which fits in 16 bits."""
_COUNT_BITS = 16
_ALL = 255
_VECTOR = 128
"""Planes without the rows above and below are a multiple of this long, which compilers unroll loops for."""
_EIGHTHS, _QUARTERS, _HALVES = 0x00AA00AA00AA00AA, 0x0000CCCC0000CCCC, 0x00000000F0F0F0F0


class Planes(NamedTuple):
    """Scratch for T chunks of the work; `D` headings, `P` bytes in a plane."""

    frontier: Array  # (T, 2, D, P) uint8: states that the step reached, and those of the step before
    closed: Array  # (T, D, P) uint8: states that have been reached, and obstacles
    first: Array  # (T, P) uint8: cells that the step reached first
    reached: Array  # (T, P) uint8: cells that have been reached
    excess: Array  # (T, 2 * D, P) uint8: bits of each heading's excess, low and high in turn
    count: Array  # (T, 16, P) uint8: bits of the least steps over headings
    words: Array  # (T, 3, P) uint64: a byte for each goal: the excess, and the low and high byte of the steps


def allocate_planes(num_threads: int, height: int, width: int, num_headings: int) -> Planes:
    """Make room for the searches on maps of (H, W)."""
    stride = width + 1
    size = 2 * stride + -(-height * stride // _VECTOR) * _VECTOR

    def plane(*shape: int) -> Array:
        return np.zeros((num_threads, *shape, size), np.uint8)

    return Planes(
        plane(2, num_headings),
        plane(num_headings),
        plane(),
        plane(),
        plane(2 * num_headings),
        plane(_COUNT_BITS),
        np.zeros((num_threads, 3, size), np.uint64),
    )


@BatchKernel
def fill_by_bfs(
    world: World, maps: Array, goals: Array, slots: Array, begins: Array, sizes: Array, distances: Distances,
    planes: Planes
) -> None:  # fmt: skip
    """Fill table `slots[k]` with the cost to go to `goals[k]` on map `maps[k]`.

    They are given in blocks of 1 to `LANES` goals of one map: block `i` has the goals from `begins[i]` on, `sizes[i]`
    of them.
    """
    chunks = planes.reached.shape[0]
    for chunk in prange(chunks):
        for i in range(chunk, begins.size, chunks):
            _fill_block(
                world, maps[begins[i]], goals[begins[i] : begins[i] + sizes[i]],
                slots[begins[i] : begins[i] + sizes[i]], distances.packed, chunk, planes
            )  # fmt: skip


@jit
def _fill_block(world: World, m: int, goals: Array, slots: Array, packed: Array, chunk: int, planes: Planes) -> None:
    frontier, closed, first = planes.frontier[chunk], planes.closed[chunk], planes.first[chunk]
    reached, excess, count = planes.reached[chunk], planes.excess[chunk], planes.count[chunk]
    stride = world.width + 1
    _close_obstacles(world.height, world.width, world.obstacle[m], closed)
    frontier[:] = 0
    reached[:] = 0
    excess[:] = 0
    count[:] = 0
    for k in range(goals.size):
        _begin(goals[k] // world.width * stride + stride + goals[k] % world.width, 1 << k, frontier[0], closed, reached)
    steps, now = 0, 0
    is_running = True
    while is_running:
        steps += 1
        _spread(stride, frontier[now], frontier[1 - now], closed)
        now = 1 - now
        is_running = _enter(frontier[now], first, reached)
        for bit in range(_COUNT_BITS):
            if steps >> bit & 1:
                _unite(first, count[bit])
        if closed.shape[0] > 1:
            for heading in range(closed.shape[0]):
                _wait(reached, closed[heading], excess[2 * heading], excess[2 * heading + 1])
    _write(world.height, world.width, reached, excess, count, planes.words[chunk], slots, packed)


@jit
def _close_obstacles(height: int, width: int, obstacle: Array, closed: Array) -> None:
    """Close all states but those of free cells."""
    closed[:] = _ALL
    for row in range(height):
        for col in range(width):
            if obstacle[row * width + col] == 0:
                for heading in range(closed.shape[0]):
                    closed[heading, (row + 1) * (width + 1) + col] = 0


@jit
def _begin(place: int, bit: int, frontier: Array, closed: Array, reached: Array) -> None:
    """Begin a search at its goal, in all headings."""
    reached[place] |= bit
    for heading in range(closed.shape[0]):
        frontier[heading, place] |= bit
        closed[heading, place] |= bit


@jit
def _spread(stride: int, before: Array, after: Array, closed: Array) -> None:
    """Find the states `after` from which one action leads to the states `before`, and close them."""
    low, high = stride, before.shape[1] - stride
    if closed.shape[0] == 1:
        own = before[0]
        _reach(
            own[low + 1 : high + 1], own[low - 1 : high - 1], own[low + stride :], own[: high - stride],
            closed[0, low:high], after[0, low:high]
        )  # fmt: skip
        return
    for heading in range(4):
        ahead = STEPS[heading][0] * stride + STEPS[heading][1]
        left, right = before[heading + 3 & 3, low:high], before[heading + 1 & 3, low:high]
        moving = before[heading, low + ahead : high + ahead]
        _reach(moving, left, right, right, closed[heading, low:high], after[heading, low:high])


@jit
def _reach(one: Array, two: Array, three: Array, four: Array, closed: Array, after: Array) -> None:
    for p in range(after.size):
        new = (one[p] | two[p] | three[p] | four[p]) & ~closed[p]
        after[p] = new
        closed[p] |= new


@jit
def _enter(after: Array, first: Array, reached: Array) -> bool:
    """Find the cells that a step reached first; return whether it reached any state."""
    total = np.uint8(0)
    one, two, three, four = after[0], after[1 % len(after)], after[2 % len(after)], after[3 % len(after)]
    for p in range(first.size):
        new = one[p] | two[p] | three[p] | four[p]
        total |= new
        first[p] = new & ~reached[p]
        reached[p] |= new
    return total != 0


@jit
def _unite(new: Array, plane: Array) -> None:
    for p in range(plane.size):
        plane[p] |= new[p]


@jit
def _wait(reached: Array, closed: Array, low: Array, high: Array) -> None:
    """Add 1 to the excess, where a cell has been reached and this heading of it has not."""
    for p in range(reached.size):
        missing = reached[p] & ~closed[p]
        high[p] |= low[p] & missing
        low[p] ^= missing


@jit
def _write(
    height: int, width: int, reached: Array, excess: Array, count: Array, words: Array, slots: Array, packed: Array
) -> None:
    """Pack the costs to go into the goals' tables."""
    if len(excess) == 8:
        _gather(excess, words[0])
    _gather(count[:8], words[1])
    _gather(count[8:], words[2])
    for k in range(slots.size):
        table, shift = packed[slots[k]], np.uint64(8 * k)
        table[height * width] = UNREACHABLE
        for row in range(height):
            first = (row + 1) * (width + 1)
            last = first + width
            _pack(
                words[0, first:last], words[1, first:last], words[2, first:last], reached[first:last], k, shift,
                table[row * width : (row + 1) * width]
            )  # fmt: skip


@jit
def _gather(planes: Array, words: Array) -> None:
    """Write the bits of eight planes to `words`, whose byte `k` gets those of goal `k`."""
    for p in range(words.size):
        word = np.uint64(0)
        for j in range(8):
            word |= np.uint64(planes[j, p]) << np.uint64(8 * j)
        words[p] = _transposed(word)


@inlined
def _transposed(word: np.uint64) -> np.uint64:
    """Return an 8 x 8 matrix of bits transposed (Warren, *Hacker's Delight*, section 7-3)."""
    swapped = (word ^ (word >> np.uint64(7))) & np.uint64(_EIGHTHS)
    word ^= swapped ^ (swapped << np.uint64(7))
    swapped = (word ^ (word >> np.uint64(14))) & np.uint64(_QUARTERS)
    word ^= swapped ^ (swapped << np.uint64(14))
    swapped = (word ^ (word >> np.uint64(28))) & np.uint64(_HALVES)
    return word ^ swapped ^ (swapped << np.uint64(28))


@jit
def _pack(excess: Array, low: Array, high: Array, reached: Array, k: int, shift: np.uint64, table: Array) -> None:
    byte = np.uint64(_ALL)
    for p in range(table.size):
        steps = (low[p] >> shift & byte) | (high[p] >> shift & byte) << np.uint64(8)
        number = np.uint32(steps << np.uint64(LEAST_BIT) | (excess[p] >> shift & byte))
        table[p] = number if reached[p] >> k & 1 else np.uint32(UNREACHABLE)
