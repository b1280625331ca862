"""Reset: agents on their starts, and nothing kept of the episode before."""

from __future__ import annotations

import numpy as np

from mapf_pz.core.jit import jit
from mapf_pz.core.state import AGENT, Array, State

_NEW = np.zeros(1, AGENT)


def reset(chosen: Array, starts: Array, headings: Array, state: State) -> None:
    """Start an episode in the environments `chosen` (K,) int64.

    Agents stand on `starts` (B, N) with `headings` (B, N), and head for the first of their goals in `state`.
    """
    _reset(chosen, starts, headings, _NEW, state)


@jit
def _reset(chosen: Array, starts: Array, headings: Array, new: Array, state: State) -> None:
    for b in chosen:
        state.time[b] = 0
        state.terminated[b] = state.truncated[b] = False
        state.occupant[b, :] = -1
        state.history[b, :, :, 0] = -1
        state.history[b, :, :, 1] = 0
        agents, goals = state.agents[b], state.goals[b]
        for i in range(agents.size):
            agents[i] = new[0]
            _place(agents[i], starts[b, i], headings[b, i], goals[i, 0])
            state.occupant[b, starts[b, i]] = i


@jit
def _place(agent: Array, start: int, heading: int, goal: int) -> None:
    """Put a new agent on its start."""
    agent.cell = agent.was_cell = start
    agent.heading = agent.was_heading = heading
    agent.goal = agent.was_goal = goal
    agent.at_goal = start == goal
    agent.active = agent.was_active = True
    agent.resting_since = -1
