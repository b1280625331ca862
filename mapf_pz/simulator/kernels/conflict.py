"""Moves: which the map allows, which cell each agent wants, and which it gets. POGEMA's three collision systems.

Kernels work on one environment: `agents` (N,) AGENT, and `occupant`, `claim` (C + 1,) int32. After
`resolve`, the cells that active agents want are pairwise different, and no two agents swap.
"""

from __future__ import annotations

from numba import prange

from mapf_pz._internal.jit import Array, BatchKernel, inlined
from mapf_pz.instances.heading import Heading
from mapf_pz.simulator.actions import Action, CardinalAction

SOFT, PRIORITY, BLOCK_BOTH = 0, 1, 2
COLLISION_SYSTEMS = {"soft": SOFT, "priority": PRIORITY, "block_both": BLOCK_BOTH}

NO_MOVE = -1
FORWARD = 0
_WAIT, _CARDINAL_WAIT = int(Action.WAIT), int(CardinalAction.WAIT)
_CARDINAL_DIRECTION = (NO_MOVE, int(Heading.NORTH), int(Heading.SOUTH), int(Heading.WEST), int(Heading.EAST))
assert [a.name for a in CardinalAction] == ["WAIT", "UP", "DOWN", "LEFT", "RIGHT"]  # the order of the line above


@inlined
def direction(cardinal: bool, heading: int, action: int) -> int:
    """Return the direction in which `action` moves, or `NO_MOVE`."""
    if cardinal:
        return _CARDINAL_DIRECTION[action]
    return heading if action == FORWARD else NO_MOVE


@inlined
def wait_of(cardinal: bool) -> int:
    """Return the action that waits."""
    return _CARDINAL_WAIT if cardinal else _WAIT


@inlined
def propose(cardinal: bool, leads_to: Array, m: int, agents: Array, actions: Array) -> None:
    """Set the cell that each agent wants: its own, if it does not move or an obstacle of map `m` is in the way."""
    for i in range(agents.size):
        agent = agents[i]
        agent.want = agent.cell
        if agent.active:
            towards = direction(cardinal, agent.heading, actions[i])
            if towards != NO_MOVE:
                agent.want = leads_to[m, towards, agent.cell]


@inlined
def resolve(system: int, agents: Array, occupant: Array, claim: Array) -> None:
    """Take back the wishes that `system` does not allow."""
    if system == SOFT:
        _stop_swaps(agents, occupant)
        _lowest_index_claims(agents, claim)
        _stop_followers_of_stayers(agents, claim)
    elif system == PRIORITY:
        _move_one_after_the_other(agents, occupant)
    else:
        _claim_alone(agents, claim)
        _enter_only_unclaimed_and_empty(agents, occupant, claim)


@inlined
def _stop_swaps(agents: Array, occupant: Array) -> None:
    for i in range(agents.size):
        agent = agents[i]
        if agent.want != agent.cell:
            j = occupant[agent.want]
            if j >= 0 and agents[j].want == agent.cell:
                agents[j].want = agents[j].cell
                agent.want = agent.cell


@inlined
def _lowest_index_claims(agents: Array, claim: Array) -> None:
    for i in range(agents.size):
        agent = agents[i]
        if agent.want != agent.cell:
            if claim[agent.want] < 0:
                claim[agent.want] = i
            else:
                agent.want = agent.cell


@inlined
def _stop_followers_of_stayers(agents: Array, claim: Array) -> None:
    """Stop each agent that claims the cell of an agent that stays, then the agents behind it; free all claims."""
    for i in range(agents.size):
        if agents[i].active and agents[i].want == agents[i].cell:
            held = agents[i].cell
            while claim[held] >= 0:
                follower = agents[claim[held]]
                claim[held] = -1
                held = follower.cell
                follower.want = held
    for i in range(agents.size):
        claim[agents[i].want] = -1


@inlined
def _move_one_after_the_other(agents: Array, occupant: Array) -> None:
    for i in range(agents.size):
        agent = agents[i]
        if agent.want != agent.cell:
            if occupant[agent.want] < 0:
                occupant[agent.cell] = -1
                occupant[agent.want] = i
            else:
                agent.want = agent.cell


_CONTESTED = -2


@inlined
def _claim_alone(agents: Array, claim: Array) -> None:
    for i in range(agents.size):
        agent = agents[i]
        if agent.want != agent.cell:
            claim[agent.want] = i if claim[agent.want] == -1 else _CONTESTED


@inlined
def _enter_only_unclaimed_and_empty(agents: Array, occupant: Array, claim: Array) -> None:
    """Refuse occupied and contested cells, then free all claims; until then `~want` marks a refused wish."""
    for i in range(agents.size):
        agent = agents[i]
        if agent.want != agent.cell and (occupant[agent.want] >= 0 or claim[agent.want] == _CONTESTED):
            agent.want = ~agent.want
    for i in range(agents.size):
        agent = agents[i]
        if agent.want >= 0:
            claim[agent.want] = -1
        else:
            claim[~agent.want] = -1
            agent.want = agent.cell


@BatchKernel
def write_masks(cardinal: bool, leads_to: Array, maps: Array, all_agents: Array, mask: Array) -> None:
    """Write `mask` (B, N, A) int8: waiting is always legal; turning, and moves to free cells, while active.

    Other agents do not count.
    """
    wait = wait_of(cardinal)
    for b in prange(maps.size):
        m, agents = maps[b], all_agents[b]
        for i in range(agents.size):
            agent = agents[i]
            for action in range(mask.shape[2]):
                towards = direction(cardinal, agent.heading, action)
                if towards == NO_MOVE:
                    mask[b, i, action] = agent.active or action == wait
                else:
                    mask[b, i, action] = agent.active and leads_to[m, towards, agent.cell] != agent.cell
