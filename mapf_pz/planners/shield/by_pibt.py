"""Collision-free actions from the preferences of any policy, by PIBT.

Veerapaneni et al., *Improving Learnt Local MAPF Policies with Heuristic Search*, ICAPS 2024 (CS-PIBT): each agent tries
its actions in the order of its preferences; if another agent is in the way and cannot move away, it tries the next one.
Actions with equal preferences are tried in the order of PIBT. Agents that turn choose the adjacent cell that they face
after their preferred turn, or the one ahead; a turn toward an obstacle is the first of two, toward the cell behind.
They choose again in each step, unlike those that follow PIBT, which keep their cell until they are there.

Policies under CS-PIBT fail by livelock: agents hold each other up forever. Therefore an agent that has not come closer
to its goal for some steps follows PIBT for as many steps: all its preferences are equal then. This is a variant of the
deadlock rule of LaGAT (Jain et al., *Graph Attention-Guided Search for Dense Multi-Agent Pathfinding*, 2025), where
agents that stand still follow PIBT until they move.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapf_pz._internal.jit import Array, jit
from mapf_pz.planners.pibt.kernels import CARDINAL_ACTIONS, decide, prepare, write_actions
from mapf_pz.planners.pibt.preference import sort_ranks
from mapf_pz.planners.pibt.state import STAY, UNDECIDED, Options, PibtState, to_go
from mapf_pz.simulator.actions import Action
from mapf_pz.simulator.kernels.cost_lookup import num_headings
from mapf_pz.simulator.kernels.state import Distances, PlanningView, State, World, planning_view_of

_ACTION_OF_CHOICE = np.array(CARDINAL_ACTIONS)
_FORWARD, _LEFT, _RIGHT, _WAIT = map(int, Action)
_NO_ACTION = -1


class Progress(NamedTuple):
    """The progress of N agents in B environments toward their goals."""

    nearest: Array  # (B, N) float32: the lowest cost to go to the current goal so far
    count: Array  # (B, N) int32: the steps without progress, up to the patience, then also those that follow PIBT


@jit
def choose_by_pibt(
    world: World,
    distances: Distances,
    state: State,
    passing: bool,
    options: Options,
    patience: int,
    preferences: Array,
    progress: Progress,
    pibt: PibtState,
    actions: Array,
) -> None:
    """Write actions (B, N) int64 such that no move is blocked.

    Args:
        world: the maps.
        distances: the cost to go to the goals of all agents.
        state: the state of the B environments.
        passing: whether an agent only has to pass its goal; otherwise it must stay there.
        options: the options of PIBT.
        patience: the number of steps without progress after which an agent follows PIBT for as many steps; 0: never.
        preferences: (B, N, A) float64, higher for better actions.
        progress: of all agents.
        pibt: the state of PIBT; its arrays have the leading dimension B.
        actions: the output.
    """
    for b in range(actions.shape[0]):
        planning_view, own = planning_view_of(world, distances, state, b), _state_of(pibt, b)
        agents, count = planning_view.agents, progress.count[b]
        for i in range(agents.size):
            count_steps(planning_view, i, patience, progress.nearest[b], count)
            if not is_stuck(count[i], patience):
                own.want[i] = UNDECIDED
        prepare(planning_view, passing, options, own)
        for i in range(agents.size):
            if own.want[i] == UNDECIDED and not is_stuck(count[i], patience):
                _prefer(planning_view, agents[i], preferences[b, i], own.rank[i])
        decide(planning_view, passing, options.swap, own)
        write_actions(planning_view, own, actions[b])
        if num_headings(planning_view.to_go) == 4:
            _turn_as_preferred(planning_view, patience, preferences[b], count, own.choice, actions[b])


@jit
def count_steps(planning_view: PlanningView, i: int, patience: int, nearest: Array, count: Array) -> None:
    """Count this step of agent i if it is one without progress, or one in which the agent ignores its preferences."""
    agent = planning_view.agents[i]
    cost = to_go(planning_view, agent, agent.cell, agent.heading)
    progress = cost < nearest[i] or agent.arrived or agent.cell == agent.goal
    if progress:
        nearest[i] = cost
    if count[i] >= patience:
        count[i] += 1
        if count[i] >= 2 * patience:
            count[i] = 0
    else:
        count[i] = 0 if progress else count[i] + 1


@jit
def is_stuck(count: int, patience: int) -> bool:
    """Return whether an agent ignores its preferences, by its `count` in `Progress`."""
    return patience > 0 and count >= patience


@jit
def num_better(preferences: Array, action: int) -> int:
    """Return the number of actions that an agent with these preferences (A,) prefers to `action`."""
    better = 0
    for other in preferences:
        better += other > preferences[action]
    return better


@jit
def _prefer(planning_view: PlanningView, agent: Array, preferences: Array, rank: Array) -> None:
    """Sort the ranks (5,) of an agent by its preferences; equal ones remain in the order of PIBT.

    Moves into obstacles come last.
    """
    leads_to, rotates = planning_view.leads_to, num_headings(planning_view.to_go) == 4
    for k in range(rank.size):
        choice = rank[k] & 7
        blocked = choice != STAY and leads_to[choice, agent.cell] == agent.cell
        if blocked:
            better = rank.size
        elif rotates:
            better = _num_better_turns(leads_to, agent, preferences, choice)
        else:
            better = num_better(preferences, _ACTION_OF_CHOICE[choice])
        rank[k] = (better << 6) | (k << 3) | choice
    sort_ranks(rank)


@jit
def _num_better_turns(leads_to: Array, agent: Array, preferences: Array, choice: int) -> int:
    """Return the number of actions that an agent prefers to the best one that leads to a choice."""
    best = _first_action(leads_to, agent, preferences, choice)
    if best != _NO_ACTION:
        return num_better(preferences, best)
    return max(num_better(preferences, _LEFT), num_better(preferences, _RIGHT))  # for the cell behind, either turn


@jit
def _first_action(leads_to: Array, agent: Array, preferences: Array, choice: int) -> int:
    """Return the action that an agent prefers of those that lead to a choice, or -1 if none does."""
    best = _NO_ACTION
    for action in range(preferences.size):
        leads = _choice_of(leads_to, agent, action) == choice
        if leads and (best == _NO_ACTION or preferences[action] > preferences[best]):
            best = action
    return best


@jit
def _choice_of(leads_to: Array, agent: Array, action: int) -> int:
    """Return the choice that an action leads to.

    For a turn, it is the cell on that side. If this is an obstacle, it is the cell behind, or, in a corner, to stay.
    """
    if action == _WAIT:
        return STAY
    if action == _FORWARD:
        return int(agent.heading)
    side, behind = (agent.heading + (1 if action == _RIGHT else 3)) & 3, (agent.heading + 2) & 3
    if leads_to[side, agent.cell] != agent.cell:
        return side
    return behind if leads_to[behind, agent.cell] != agent.cell else STAY


@jit
def _turn_as_preferred(
    planning_view: PlanningView, patience: int, preferences: Array, count: Array, choice: Array, actions: Array
) -> None:
    """Replace the actions (N,) of agents that prefer another one of those that lead to their choices (N,)."""
    for i, agent in enumerate(planning_view.agents):
        if not agent.active or is_stuck(count[i], patience):
            continue
        if choice[i] == STAY:
            best = _first_action(planning_view.leads_to, agent, preferences[i], STAY)
            if preferences[i, best] > preferences[i, _WAIT]:
                actions[i] = best
        elif ((choice[i] - agent.heading) & 3) == 2 and preferences[i, _LEFT] > preferences[i, _RIGHT]:
            actions[i] = _LEFT


@jit
def _state_of(pibt: PibtState, b: int) -> PibtState:
    """Return the state of PIBT in environment `b`."""
    return PibtState(
        pibt.want[b],
        pibt.away[b],
        pibt.first_cost[b],
        pibt.order[b],
        pibt.key[b],
        pibt.merged[b],
        pibt.taken[b],
        pibt.rank[b],
        pibt.closer[b],
        pibt.demand[b],
        pibt.pull[b],
        pibt.tried[b],
        pibt.choice[b],
        pibt.chain[b],
        pibt.resolved[b],
        pibt.random[b],
    )
