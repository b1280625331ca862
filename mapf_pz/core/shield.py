"""Preferences of any policy, carried out without collisions by PIBT.

Veerapaneni et al., *Improving Learnt Local MAPF Policies with Heuristic Search*, ICAPS 2024 (CS-PIBT): each agent tries
its actions in the order of its preferences, and whoever is in the way must move on, or it tries the next.
"""

from __future__ import annotations

from mapf_pz.core.jit import jit
from mapf_pz.core.pibt import (
    CARDINAL_ACTIONS,
    NOBODY,
    NOT_AT_ALL,
    STAY,
    UNDECIDED,
    Desk,
    decide,
    prioritize,
    write_cardinal,
)
from mapf_pz.core.state import Arena, Array
from mapf_pz.types import Action

_FORWARD = int(Action.FORWARD)


@jit
def carry_out(arena: Arena, preferences: Array, passing: bool, desk: Desk, actions: Array) -> None:
    """Write an action (N,) int64 for each agent, such that nobody's move is prevented.

    `preferences` (N, A) float64 are higher for better actions, A = 5 for cardinal agents; the rest is as in
    `mapf_pz.core.pibt.plan`.
    """
    crew = arena.crew
    prioritize(arena, passing, desk)
    desk.taken[:] = NOBODY
    for i in range(crew.size):
        desk.want[i], desk.choice[i] = UNDECIDED if crew[i].active else crew[i].cell, STAY
        if preferences.shape[1] == len(CARDINAL_ACTIONS):
            _rank_cardinal(preferences[i], desk.rank[i])
        else:
            # Turning is staying, and whoever must give way can but drive ahead.
            desk.rank[i] = NOT_AT_ALL
            desk.rank[i, STAY] = 8 + STAY
            desk.rank[i, crew[i].heading] = crew[i].heading + (0 if preferences[i].argmax() == _FORWARD else 16)
    decide(arena, desk)
    if preferences.shape[1] == len(CARDINAL_ACTIONS):
        write_cardinal(desk, actions)
        return
    for i in range(crew.size):
        if desk.want[i] != crew[i].cell:
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
