"""Preferences of any policy, carried out without collisions by PIBT.

Veerapaneni et al., *Improving Learnt Local MAPF Policies with Heuristic Search*, ICAPS 2024 (CS-PIBT): each agent tries
its actions in the order of its preferences, and whoever is in the way must move on, or it tries the next.
"""

from __future__ import annotations

from mapf_pz.actions import Action
from mapf_pz.core.jit import jit
from mapf_pz.core.state import Array, PlanningView
from mapf_pz.planners.pibt.kernels import (
    CARDINAL_ACTIONS,
    NOBODY,
    NOT_AT_ALL,
    STAY,
    UNDECIDED,
    PibtState,
    decide,
    prioritize,
    write_cardinal,
)

_FORWARD = int(Action.FORWARD)


@jit
def carry_out(planning_view: PlanningView, preferences: Array, passing: bool, state: PibtState, actions: Array) -> None:
    """Write an action (N,) int64 for each agent, such that nobody's move is prevented.

    `preferences` (N, A) float64 are higher for better actions, A = 5 for cardinal agents; the rest is as in
    `mapf_pz.planners.pibt.kernels.plan`.
    """
    agents = planning_view.agents
    prioritize(planning_view, passing, state)
    state.taken[:] = NOBODY
    for i in range(agents.size):
        state.want[i], state.choice[i] = UNDECIDED if agents[i].active else agents[i].cell, STAY
        if preferences.shape[1] == len(CARDINAL_ACTIONS):
            _rank_cardinal(preferences[i], state.rank[i])
        else:
            # Turning is staying, and whoever must give way can but drive ahead.
            state.rank[i] = NOT_AT_ALL
            state.rank[i, STAY] = 8 + STAY
            state.rank[i, agents[i].heading] = agents[i].heading + (0 if preferences[i].argmax() == _FORWARD else 16)
    decide(planning_view, state)
    if preferences.shape[1] == len(CARDINAL_ACTIONS):
        write_cardinal(state, actions)
        return
    for i in range(agents.size):
        if state.want[i] != agents[i].cell:
            actions[i] = _FORWARD
        else:
            actions[i] = _FORWARD + 1 + preferences[i, _FORWARD + 1 :].argmax()


@jit
def _rank_cardinal(preferences: Array, rank: Array) -> None:
    """Rank the four headings and staying by the preferences of their actions."""
    for k in range(5):
        better = 0
        for other in CARDINAL_ACTIONS:
            better += preferences[other] > preferences[CARDINAL_ACTIONS[k]]
        rank[k] = 8 * better + k
