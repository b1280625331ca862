"""Preferences of any policy, carried out without collisions by PIBT.

Veerapaneni et al., *Improving Learnt Local MAPF Policies with Heuristic Search*, ICAPS 2024 (CS-PIBT): each agent tries
its actions in the order of its preferences, and whoever is in the way must move on, or it tries the next.
"""

from __future__ import annotations

from mapf_pz.core.jit import jit
from mapf_pz.core.pibt import CARDINAL_ACTIONS, NOBODY, STAY, UNDECIDED, Desk, decide, prioritize, write_cardinal
from mapf_pz.core.state import Array
from mapf_pz.types import Action

_FORWARD = int(Action.FORWARD)


@jit
def carry_out(
    leads_to: Array, slot: Array, to_go: Array, crew: Array, occupant: Array, preferences: Array,
    passing: bool, desk: Desk, actions: Array
) -> None:  # fmt: skip
    """Write an action (N,) int64 for each agent, such that nobody's move is prevented.

    `preferences` (N, A) float64 are higher for better actions, A = 5 for cardinal agents; the other arrays are those of
    `mapf_pz.core.pibt.plan`.
    """
    prioritize(slot, to_go, crew, passing, desk)
    desk.taken[:] = NOBODY
    for i in range(crew.size):
        desk.want[i] = UNDECIDED if crew[i].active else crew[i].cell
        if preferences.shape[1] == len(CARDINAL_ACTIONS):
            _rank_cardinal(preferences[i], desk.choices[i])
        else:
            # Turning is staying, and whoever must give way can but drive ahead.
            ahead = preferences[i].argmax() == _FORWARD
            desk.choices[i] = STAY
            desk.choices[i, 0 if ahead else 1] = crew[i].heading
    decide(leads_to, crew, occupant, desk)
    if preferences.shape[1] == len(CARDINAL_ACTIONS):
        write_cardinal(leads_to, crew, desk.want, actions)
        return
    for i in range(crew.size):
        if desk.want[i] != crew[i].cell:
            actions[i] = _FORWARD
        else:
            actions[i] = _FORWARD + 1 + preferences[i, _FORWARD + 1 :].argmax()


@jit
def _rank_cardinal(preferences: Array, choices: Array) -> None:
    """Sort the choices, the four headings and staying, by the preferences of their actions."""
    for k in range(5):
        place = k
        while place > 0 and preferences[CARDINAL_ACTIONS[k]] > preferences[CARDINAL_ACTIONS[choices[place - 1]]]:
            choices[place] = choices[place - 1]
            place -= 1
        choices[place] = k
