"""Reading a cost-to-go table: what each action is worth, and which cell comes next on the cheapest path."""

from __future__ import annotations

import numpy as np

from mapf_pz.core.conflict import NO_MOVE, direction
from mapf_pz.core.jit import jit
from mapf_pz.core.state import WAIT_WEIGHT, Array
from mapf_pz.types import Action

_LEFT, _RIGHT = int(Action.ROTATE_LEFT), int(Action.ROTATE_RIGHT)
_STRAIGHT_RIGHT_LEFT_BACK = ((0, 0), (1, 1), (3, 1), (2, 2))  # (turn to the right, number of turns it takes)


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
