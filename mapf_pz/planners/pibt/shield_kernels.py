"""Collision-free actions from the preferences of any policy, by PIBT.

Veerapaneni et al., *Improving Learnt Local MAPF Policies with Heuristic Search*, ICAPS 2024 (CS-PIBT): each agent tries
its actions in the order of its preferences; if another agent is in the way and cannot move away, it tries the next one.
"""

from __future__ import annotations

from mapf_pz.actions import Action
from mapf_pz.core.jit import jit
from mapf_pz.core.state import Array, PlanningView
from mapf_pz.planners.pibt.kernels import CARDINAL_ACTIONS, decide, write_cardinal
from mapf_pz.planners.pibt.preference import sort_ranks
from mapf_pz.planners.pibt.priority import prioritize
from mapf_pz.planners.pibt.state import NEAREST, NO_AGENT, NO_RANK, STAY, UNDECIDED, PibtState

_FORWARD = int(Action.FORWARD)


@jit
def choose_actions(
    planning_view: PlanningView, preferences: Array, passing: bool, state: PibtState, actions: Array
) -> None:
    """Write an action (N,) int64 for each agent, such that no move is blocked.

    `preferences` (N, A) float64 are higher for better actions, A = 5 for cardinal agents; the rest is as in
    `mapf_pz.planners.pibt.kernels.plan`.
    """
    agents = planning_view.agents
    prioritize(planning_view, passing, NEAREST, state)
    state.taken[:] = NO_AGENT
    for i in range(agents.size):
        state.want[i], state.choice[i] = UNDECIDED if agents[i].active else agents[i].cell, STAY
        if preferences.shape[1] == len(CARDINAL_ACTIONS):
            _rank_cardinal(preferences[i], state.rank[i])
        else:
            # An agent that turns stays on its cell, and an agent that must move away can only move forward.
            state.rank[i] = NO_RANK
            state.rank[i, STAY] = 8 + STAY
            state.rank[i, agents[i].heading] = agents[i].heading + (0 if preferences[i].argmax() == _FORWARD else 16)
        sort_ranks(state.rank[i])
    decide(planning_view, False, state)
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
    """Rank the four directions and staying by the preferences for their actions."""
    for k in range(5):
        better = 0
        for other in CARDINAL_ACTIONS:
            better += preferences[other] > preferences[CARDINAL_ACTIONS[k]]
        rank[k] = 8 * better + k
