"""Reading the cost to go, which is stored in one of two forms.

Where all weights are 1, the costs from the four headings of a cell differ by at most two turns. They are packed into
one number, `least << 8 | excess[3] << 6 | excess[2] << 4 | excess[1] << 2 | excess[0]`: the least cost over headings,
and what each heading costs more. For cardinal agents, the excess is 0. Otherwise each cost is a float.
"""

from __future__ import annotations

import numpy as np

from mapf_pz._internal.jit import Array, inlined, jit
from mapf_pz.simulator.actions import Action
from mapf_pz.simulator.kernels.conflict import NO_MOVE, direction
from mapf_pz.simulator.kernels.state import WAIT_WEIGHT, CostToGo

LEAST_BIT = 8
"""The position of the least cost in a packed number; two bits for each heading come before it."""
ALL_EXCESS = 2**LEAST_BIT - 1
"""The bits of what all headings cost more."""
UNREACHABLE = 2**32 - 1
"""The packed number of cells without a path to the goal."""
_LEFT, _RIGHT = int(Action.ROTATE_LEFT), int(Action.ROTATE_RIGHT)
_STRAIGHT_RIGHT_LEFT_BACK = ((0, 0), (1, 1), (3, 1), (2, 2))  # (turn to the right, number of turns it takes)


@inlined
def num_headings(to_go: CostToGo) -> int:
    """Return the number of headings: 4, or 1 for cardinal agents."""
    return to_go.exact.shape[2]


@inlined
def cost_at(to_go: CostToGo, table: int, cell: int, heading: int) -> np.float32:
    """Return the cost to go from a cell and heading by a table; inf: there is no path."""
    if to_go.packed.shape[0] == 0:
        return to_go.exact[table, cell, heading & (to_go.exact.shape[2] - 1)]
    return unpack(to_go.packed[table, cell], heading)


@inlined
def unpack(number: int, heading: int) -> np.float32:
    """Return the cost from a heading by a packed number; inf: there is no path."""
    return np.float32(np.inf) if number == UNREACHABLE else np.float32(unpack_steps(number, heading))


@inlined
def unpack_steps(number: int, heading: int) -> int:
    """Return the steps from a heading by a packed number; 2**24 or more: there is no path."""
    bits = np.int64(number)
    return int((bits >> LEAST_BIT) + (bits >> 2 * heading & 3))


@inlined
def least_cost_at(to_go: CostToGo, table: int, cell: int) -> np.float32:
    """Return the least cost to go over the headings of a cell; inf: there is no path."""
    if to_go.packed.shape[0] == 0:
        return to_go.least[table, cell]
    bits = np.int64(to_go.packed[table, cell])
    return np.float32(np.inf) if bits == UNREACHABLE else np.float32(bits >> LEAST_BIT)


@jit
def costs_at(to_go: CostToGo, tables: Array, cells: Array, headings: Array) -> Array:
    """Return the costs to go (N,) float32 from `cells` and `headings` by `tables`, (N,) each."""
    costs = np.empty(cells.size, np.float32)
    for i in range(cells.size):
        costs[i] = cost_at(to_go, tables[i], cells[i], headings[i])
    return costs


@jit
def least_costs(to_go: CostToGo, tables: Array) -> Array:
    """Return the least costs to go (N, C + 1) float32 over headings by `tables` (N,)."""
    costs = np.empty((tables.size, to_go.exact.shape[1]), np.float32)
    for i in range(tables.size):
        for cell in range(costs.shape[1]):
            costs[i, cell] = least_cost_at(to_go, tables[i], cell)
    return costs


@jit
def turned(heading: int, action: int) -> int:
    """Return the heading after `action` of the rotating model."""
    if action == _LEFT:
        return (heading + 3) % 4
    if action == _RIGHT:
        return (heading + 1) % 4
    return heading


@inlined
def advantage(
    leads_to: Array, weight: Array, mean_weight: float, to_go: CostToGo, table: int, own: np.float32, cardinal: bool,
    agent: Array, action: int
) -> float:  # fmt: skip
    """Return `clip((D - c(action) - D') / mean weight, -2, 0) / 2`: 0 for the best action, -1 for a blocked one.

    `leads_to`, `weight` and `mean_weight` are those of one map, `table` is the agent's, and `own` is D.
    """
    cell, heading = agent.cell, agent.heading
    towards = direction(cardinal, heading, action)
    if own == np.inf:
        return -1.0
    if towards != NO_MOVE:  # a blocked move costs infinitely much
        after = weight[towards, cell] + cost_at(to_go, table, leads_to[towards, cell], heading)
    elif cardinal or turned(heading, action) == heading:
        after = own + (0.0 if cell == agent.goal else weight[WAIT_WEIGHT, cell])  # resting on the goal is free
    else:
        after = weight[WAIT_WEIGHT, cell] + cost_at(to_go, table, cell, turned(heading, action))
    return float(min(max((own - after) / mean_weight, -2.0), 0.0) / 2)


@inlined
def next_cell(leads_to: Array, weight: Array, to_go: CostToGo, table: int, cell: int, heading: int) -> int:
    """Return the next other cell on the cheapest path to the goal, or -1 on the goal and where there is no path.

    Of equal paths, the one that begins straight ahead comes first, then right, left, back (cardinal: east, south, west,
    north).
    """
    rotates = num_headings(to_go) == 4
    best, best_cost = -1, np.inf
    if cost_at(to_go, table, cell, heading) == 0:
        return best
    for k in range(4):
        turn, turns = _STRAIGHT_RIGHT_LEFT_BACK[k]
        towards = (heading + turn) % 4 if rotates else k
        target = leads_to[towards, cell]
        cost = weight[towards, cell] + cost_at(to_go, table, target, towards)
        if rotates:
            cost += turns * weight[WAIT_WEIGHT, cell]
        if cost < best_cost:
            best, best_cost = target, cost
    return best
