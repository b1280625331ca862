"""Collision-free actions from the preferences of any policy, by PIBT.

Veerapaneni et al., *Improving Learnt Local MAPF Policies with Heuristic Search*, ICAPS 2024 (CS-PIBT): each agent tries
its actions in the order of its preferences; if another agent is in the way and cannot move away, it tries the next one.
Actions with equal preferences are tried in the order of PIBT. Agents that turn choose the adjacent cell that they face
after their preferred turn, or the one ahead, and keep it until they are there, as in the causal PIBT.

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
        agents = planning_view.agents
        prepare(planning_view, passing, options, own)
        for i in range(agents.size):
            stuck = is_stuck(planning_view, i, patience, progress.nearest[b], progress.count[b])
            if not stuck and own.want[i] == UNDECIDED:
                _prefer(planning_view, agents[i], preferences[b, i], own.rank[i])
        decide(planning_view, options.swap, own)
        write_actions(planning_view, own, actions[b])


@jit
def is_stuck(planning_view: PlanningView, i: int, patience: int, nearest: Array, count: Array) -> bool:
    """Count the steps of agent i without progress, and return whether it ignores its preferences in this step."""
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
    return patience > 0 and count[i] >= patience


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
            better = _num_better_turns(preferences, choice, agent.heading)
        else:
            better = num_better(preferences, _ACTION_OF_CHOICE[choice])
        rank[k] = (better << 6) | (k << 3) | choice
    sort_ranks(rank)


@jit
def _num_better_turns(preferences: Array, choice: int, heading: int) -> int:
    """Return the number of actions that an agent prefers to the one that leads to a choice from its heading."""
    turn = (choice - heading) & 3
    if choice == STAY:
        return num_better(preferences, _WAIT)
    if turn == 2:  # after the other turn comes the cell on that side
        return max(num_better(preferences, _LEFT), num_better(preferences, _RIGHT))
    return num_better(preferences, _FORWARD if turn == 0 else (_RIGHT if turn == 1 else _LEFT))


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
