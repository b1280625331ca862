"""How two agents change places in front of a dead end.

An agent that pushes another one into a dead end gets stuck if its goal is the last cell: the other cannot leave. It
moves back instead, the other agent follows, and where there is room the other turns off. This is the part of the swap
technique (Okumura, *Improving LaCAM for Scalable Eventually Optimal Multi-Agent Pathfinding*, IJCAI 2023) that also
increases the number of goals reached in lifelong episodes, where an agent at its goal gets a new one and moves on.
"""

from __future__ import annotations

from mapf_pz._internal.jit import Array, jit
from mapf_pz.planners.pibt.state import NO_AGENT, STAY, UNDECIDED, PibtState
from mapf_pz.simulator.kernels.state import PlanningView

_NOWHERE = -1


@jit
def prefer_room(planning_view: PlanningView, i: int, want: Array, rank: Array) -> int:
    """Reverse the order of agent i's choices if its first choice leads to an agent that must leave a dead end.

    Return the direction of that agent, otherwise -1.
    """
    leads_to, agents = planning_view.leads_to, planning_view.agents
    cell, first = agents[i].cell, rank[0] & 7
    if first == STAY:
        return _NOWHERE
    best, goal = leads_to[first, cell], agents[i].goal
    ahead = planning_view.occupant[best]
    if ahead == NO_AGENT or want[ahead] != UNDECIDED or agents[ahead].goal == goal:
        return _NOWHERE
    if not _ends_at(leads_to, cell, best, goal) or not _has_room(leads_to, best, cell):
        return _NOWHERE
    for k in range(2):
        rank[k], rank[4 - k] = rank[4 - k], rank[k]
    return first


@jit
def pull_agents(planning_view: PlanningView, depth: int, state: PibtState) -> None:
    """Let agents that must leave a dead end follow those of the first `depth` in the chain that make room for them."""
    for k in range(depth):
        i = state.chain[k]
        if state.pull[i] == _NOWHERE:
            continue
        cell = planning_view.agents[i].cell
        there = planning_view.leads_to[state.pull[i], cell]
        other = planning_view.occupant[there]
        if state.want[other] == UNDECIDED and state.taken[cell] == NO_AGENT and state.want[i] != there:
            state.want[other], state.choice[other] = cell, (state.pull[i] + 2) & 3
            state.taken[cell] = other


@jit
def _ends_at(leads_to: Array, back: int, front: int, goal: int) -> bool:
    """Return whether the way from `back` over `front` has no branches and ends at `goal`, a dead end."""
    exits, onward = _exits(leads_to, back, front)
    while exits == 1 and front != goal:
        back, front = front, onward
        exits, onward = _exits(leads_to, back, front)
    return exits == 0 and front == goal


@jit
def _has_room(leads_to: Array, back: int, front: int) -> bool:
    """Return whether two agents that move from `back` to `front` and beyond reach a branch."""
    entry = back
    exits, onward = _exits(leads_to, back, front)
    while exits == 1 and onward != entry:
        back, front = front, onward
        exits, onward = _exits(leads_to, back, front)
    return exits > 1


@jit
def _exits(leads_to: Array, back: int, front: int) -> tuple[int, int]:
    """Return the number of cells adjacent to `front` except `back`, and the last of them."""
    exits, onward = 0, front
    for direction in range(4):
        cell = leads_to[direction, front]
        if cell not in (front, back):
            exits += 1
            onward = cell
    return exits, onward
