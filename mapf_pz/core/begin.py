"""Beginning an episode: the agents on their starts, and nothing remembered of the one before."""

from __future__ import annotations

from mapf_pz.core.jit import jit
from mapf_pz.core.state import Array


@jit
def begin(starts: Array, headings: Array, goals: Array, crew: Array, occupant: Array, history: Array) -> None:
    """Put agents on `starts` (N,) with `headings` (N,), each with the first of its `goals` (N, G) to reach.

    `crew` (N,) is all zeros; `occupant` (C + 1,) and `history` (N, L, 2) are written over.
    """
    occupant[:] = -1
    for i in range(crew.size):
        agent = crew[i]
        occupant[starts[i]] = i
        agent.cell = agent.was_cell = starts[i]
        agent.heading = agent.was_heading = headings[i]
        agent.goal = agent.was_goal = goals[i, 0]
        agent.at_goal = starts[i] == goals[i, 0]
        agent.active = agent.was_active = True
        agent.settled = -1
        for k in range(history.shape[1]):
            history[i, k, 0] = -1
            history[i, k, 1] = 0
