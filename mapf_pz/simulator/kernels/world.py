"""The map and its guidance graph, laid out for the kernels: what never changes during an episode."""

from __future__ import annotations

import numpy as np

from mapf_pz._internal.arrays import Bools
from mapf_pz._internal.jit import Array, jit
from mapf_pz.guidance import GuidanceGraph
from mapf_pz.instances.heading import HEADING_STEPS
from mapf_pz.simulator.kernels.state import WAIT_WEIGHT, World

STEPS = tuple((int(r), int(c)) for r, c in HEADING_STEPS)


def allocate(num_maps: int, shape: tuple[int, int]) -> World:
    """Make room for `num_maps` maps of `shape` (H, W)."""
    cells = shape[0] * shape[1] + 1
    return World(
        height=shape[0],
        width=shape[1],
        leads_to=np.zeros((num_maps, 4, cells), np.int32),
        weight=np.full((num_maps, 5, cells), np.inf, np.float32),
        obstacle=np.ones((num_maps, cells), np.float32),
        mean_weight=np.ones(num_maps, np.float32),
        equal_weight=np.ones(num_maps, np.float32),
    )


def set_map(world: World, m: int, free: Bools, guidance: GuidanceGraph) -> None:
    """Write the map `free` (H, W) and its guidance graph to row `m` of `world`."""
    _set_map(
        free,
        guidance.move,
        guidance.wait,
        world.leads_to[m],
        world.weight[m],
        world.obstacle[m],
        world.mean_weight[m : m + 1],
        world.equal_weight[m : m + 1],
    )


@jit
def _set_map(
    free: Array,
    free_move: Array,
    free_wait: Array,
    leads_to: Array,
    weight: Array,
    obstacle: Array,
    mean_weight: Array,
    equal_weight: Array,
) -> None:
    height, width = free.shape
    outside = height * width
    leads_to[:, outside] = outside
    total, count, largest, smallest = 0.0, 0, 0.0, np.inf
    one_way = False
    for row in range(height):
        for col in range(width):
            here = row * width + col
            obstacle[here] = 0.0 if free[row, col] else 1.0
            weight[WAIT_WEIGHT, here] = free_wait[row, col]
            if free[row, col]:
                price = weight[WAIT_WEIGHT, here]
                total, count, largest, smallest = total + price, count + 1, max(largest, price), min(smallest, price)
            for d in range(4):
                r, c = row + STEPS[d][0], col + STEPS[d][1]
                is_open = free[row, col] and 0 <= r < height and 0 <= c < width and free[r, c]
                leads_to[d, here] = r * width + c if is_open else here
                price = np.float32(free_move[d, row, col] if is_open else np.inf)
                weight[d, here] = price
                one_way |= is_open and price == np.inf
                if price < np.inf:
                    total, count, largest, smallest = (
                        total + price,
                        count + 1,
                        max(largest, price),
                        min(smallest, price),
                    )
    mean_weight[0] = total / count  # there is a free cell, since agents start on one
    equal_weight[0] = largest if largest == smallest and not one_way else 0.0
