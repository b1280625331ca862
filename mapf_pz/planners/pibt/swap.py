"""How two agents change places: one moves away from its goal, the other follows, and where there is room one turns off.

If agents must stay at their goals, the rule is that of corridors, `mapf_pz.planners.corridor`, for agents that face
each other in any corridor. If they only have to pass their goals, it is that of dead ends, the part of it that also
increases the number of goals reached in lifelong episodes: an agent that pushes another one into a dead end gets stuck
if its goal is the last cell, since the other cannot leave.
"""

from __future__ import annotations

from mapf_pz._internal.jit import Array, jit
from mapf_pz.planners.corridor import degree, has_room, must_swap
from mapf_pz.planners.pibt.state import NO_AGENT, STAY, UNDECIDED, PibtState
from mapf_pz.simulator.kernels.state import PlanningView

_NOWHERE = -1


@jit
def find_partner(planning_view: PlanningView, passing: bool, i: int, want: Array, rank: Array) -> int:
    """Reverse the order of agent i's choices if it must change places with an agent beside it.

    Return the direction of that agent, which is to follow, otherwise -1.
    """
    cell, first = planning_view.agents[i].cell, rank[0] & 7
    if first == STAY or planning_view.leads_to[first, cell] == cell:
        return _NOWHERE
    if not passing:
        partner = _in_a_corridor(planning_view, i, first, want)
    else:
        partner = first if _leaves_a_dead_end(planning_view, i, planning_view.leads_to[first, cell], want) else _NOWHERE
    if partner != _NOWHERE:
        last = degree(planning_view.leads_to, cell)  # of the choices that are possible, which come first
        for k in range((last + 1) // 2):
            rank[k], rank[last - k] = rank[last - k], rank[k]
    return partner


@jit
def pull_agents(planning_view: PlanningView, passing: bool, depth: int, state: PibtState) -> None:
    """Let partners follow those of the first `depth` agents in the chain that move away from their goals for them."""
    for k in range(depth):
        i = state.chain[k]
        if state.pull[i] == _NOWHERE:
            continue
        cell = planning_view.agents[i].cell
        there = planning_view.leads_to[state.pull[i], cell]
        other = planning_view.occupant[there]
        moves_away = state.want[i] != there if passing else state.tried[i] == 1
        if moves_away and state.want[other] == UNDECIDED and state.taken[cell] == NO_AGENT:
            state.want[other], state.choice[other] = cell, (state.pull[i] + 2) & 3
            state.taken[cell] = other


@jit
def _in_a_corridor(planning_view: PlanningView, i: int, first: int, want: Array) -> int:
    """Return the direction of the agent that agent i must change places with, whose first choice is `first`, or -1."""
    leads_to, to_go, slot = planning_view.leads_to, planning_view.to_go, planning_view.slot
    agents, occupant, goals = planning_view.agents, planning_view.occupant, planning_view.agents["goal"]
    cell, own = agents[i].cell, slot[agents[i].goal]
    best = leads_to[first, cell]
    if not has_room(leads_to, goals, occupant, best, cell):
        return _NOWHERE
    ahead = occupant[best]
    can_yield = ahead != NO_AGENT and want[ahead] == UNDECIDED and goals[ahead] != goals[i]
    if can_yield and must_swap(leads_to, to_go, goals, occupant, own, slot[goals[ahead]], cell, best):
        return first
    for direction in range(4):
        beside = leads_to[direction, cell]
        behind = occupant[beside]
        if beside in (cell, best) or behind == NO_AGENT or goals[behind] == goals[i]:
            continue
        if must_swap(leads_to, to_go, goals, occupant, slot[goals[behind]], own, cell, best):
            return direction
    return _NOWHERE


@jit
def _leaves_a_dead_end(planning_view: PlanningView, i: int, best: int, want: Array) -> bool:
    """Return whether the agent on `best`, agent i's first choice, must leave the dead end in which i's goal is."""
    leads_to, agents = planning_view.leads_to, planning_view.agents
    cell, goal, ahead = agents[i].cell, agents[i].goal, planning_view.occupant[best]
    if ahead == NO_AGENT or want[ahead] != UNDECIDED or agents[ahead].goal == goal:
        return False
    return bool(_ends_at(leads_to, cell, best, goal) and _reaches_a_branch(leads_to, best, cell))


@jit
def _ends_at(leads_to: Array, back: int, front: int, goal: int) -> bool:
    """Return whether the way from `back` over `front` has no branches and ends at `goal`, a dead end."""
    exits, onward = _exits(leads_to, back, front)
    while exits == 1 and front != goal:
        back, front = front, onward
        exits, onward = _exits(leads_to, back, front)
    return exits == 0 and front == goal


@jit
def _reaches_a_branch(leads_to: Array, back: int, front: int) -> bool:
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
