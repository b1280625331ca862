"""The action mask: which actions the map allows. Other agents do not count."""

from __future__ import annotations

from numba import prange

from mapf_pz.actions import Action, CardinalAction
from mapf_pz.core.conflict import NO_MOVE, direction
from mapf_pz.core.jit import BatchKernel
from mapf_pz.core.state import Array

_WAIT, _CARDINAL_WAIT = int(Action.WAIT), int(CardinalAction.WAIT)


@BatchKernel
def write_masks(cardinal: bool, leads_to: Array, maps: Array, all_agents: Array, mask: Array) -> None:
    """Write `mask` (B, N, A) int8: waiting is always legal; turning, and moves to free cells, while active."""
    wait = _CARDINAL_WAIT if cardinal else _WAIT
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
