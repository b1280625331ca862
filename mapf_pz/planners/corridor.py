"""Whether two agents in a corridor must change places, and where there is room for it.

Of two agents that face each other in a corridor, neither gets to its goal by pushing the other one, which comes back
afterward. They must move to a branch together, where one of them turns off, so that they can go on in the other order.
This is the swap technique of PIBT (Okumura, *Improving LaCAM for Scalable Eventually Optimal Multi-Agent Pathfinding*,
IJCAI 2023; *Engineering LaCAM**, AAMAS 2024). The agent that pushes is the pusher, and the one ahead of it the puller.
"""

from __future__ import annotations

from mapf_pz._internal.jit import Array, jit
from mapf_pz.simulator.kernels.cost_lookup import least_cost_at
from mapf_pz.simulator.kernels.state import CostToGo

_NO_AGENT = -1


@jit
def must_swap(
    leads_to: Array, to_go: CostToGo, goals: Array, occupant: Array, pusher: int, puller: int, back: int, front: int
) -> bool:
    """Return whether a pusher on `back` and a puller on `front` must change places along the corridor ahead.

    Args:
        leads_to: (4, C + 1) int32, the cell that a move in each direction leads to; the same cell if blocked.
        to_go: the cost to go.
        goals: (N,) int32, the goal of each agent.
        occupant: (C + 1,) int32, the agent on each cell; -1: none.
        pusher: table of the cost to the pusher's goal.
        puller: table of the cost to the puller's goal.
        back: cell.
        front: cell adjacent to `back`.
    """
    # Both agents move along the pusher's way to its goal, as long as there is only one way for them.
    while least_cost_at(to_go, pusher, front) < least_cost_at(to_go, pusher, back):
        exits, onward = _exits(leads_to, goals, occupant, back, front)
        if exits > 1:
            return False
        if exits == 0:
            break
        back, front = front, onward
    # Each of the two has to get past the other: the puller to a goal behind the pusher, and the pusher to one behind
    # the puller, unless it has arrived.
    remaining = least_cost_at(to_go, pusher, back)
    yields = least_cost_at(to_go, puller, back) < least_cost_at(to_go, puller, front)
    return bool(yields and (remaining == 0 or least_cost_at(to_go, pusher, front) < remaining))


@jit
def has_room(leads_to: Array, goals: Array, occupant: Array, back: int, front: int) -> bool:
    """Return whether two agents that move from `back` to `front` and beyond reach a cell with two further exits."""
    entry = back
    while front != entry:
        exits, onward = _exits(leads_to, goals, occupant, back, front)
        if exits != 1:
            return exits > 1
        back, front = front, onward
    return False


@jit
def degree(leads_to: Array, cell: int) -> int:
    """Return the number of cells adjacent to `cell`."""
    count = 0
    for direction in range(4):
        count += leads_to[direction, cell] != cell
    return count


@jit
def _exits(leads_to: Array, goals: Array, occupant: Array, back: int, front: int) -> tuple[int, int]:
    """Return the number of exits of `front` except `back`, and the last of them; occupied dead ends do not count."""
    exits, onward = 0, front
    for direction in range(4):
        cell = leads_to[direction, front]
        if cell in (front, back):
            continue
        rests = occupant[cell] != _NO_AGENT and goals[occupant[cell]] == cell
        if rests and degree(leads_to, cell) == 1:
            continue
        exits += 1
        onward = cell
    return exits, onward
