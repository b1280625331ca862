"""The action mask: which actions the map allows. Other agents do not count."""

from __future__ import annotations

from numba import prange

from mapf_pz.core.conflict import NO_MOVE, direction
from mapf_pz.core.jit import jit, parallel_jit
from mapf_pz.core.state import Array, State
from mapf_pz.types import Action, CardinalAction

_WAIT, _CARDINAL_WAIT = int(Action.WAIT), int(CardinalAction.WAIT)


def _write_masks(cardinal: bool, leads_to: Array, state: State, mask: Array) -> None:
    """Write `mask` (B * N, A) int8: waiting is always legal; turning, and moves to free cells, while active."""
    wait = _CARDINAL_WAIT if cardinal else _WAIT
    for b in prange(state.time.size):
        m, crew = state.map[b], state.agents[b]
        for i in range(crew.size):
            agent, row = crew[i], b * crew.size + i
            for action in range(mask.shape[1]):
                towards = direction(cardinal, agent.heading, action)
                if towards == NO_MOVE:
                    mask[row, action] = agent.active or action == wait
                else:
                    mask[row, action] = agent.active and leads_to[m, towards, agent.cell] != agent.cell


write_masks = jit(_write_masks)
write_masks_in_parallel = parallel_jit(_write_masks)
