"""Collision-free actions from the preferences of any policy, by EPIBT, for agents that turn and only pass their goals.

Agents that turn need several steps to make way for each other, so they agree on operations, sequences of several
actions, as in EPIBT (`mapf_pz.planners.epibt.kernels`). Each agent tries its operations in the order of its preferences
for their first actions, and in the order of EPIBT where these are equal. An agent that has not come closer to its goal
for some steps follows EPIBT for as many steps, as in `mapf_pz.planners.shield.by_pibt`.
"""

from __future__ import annotations

from typing import NamedTuple

from mapf_pz._internal.jit import Array, jit
from mapf_pz.planners.copying import copy_row
from mapf_pz.planners.epibt.kernels import continue_operations, decide, evaluate, first_actions, pack_option
from mapf_pz.planners.epibt.state import LAST_OPERATION, EpibtState, Operations
from mapf_pz.planners.shield.by_pibt import Progress, count_steps, is_stuck, num_better
from mapf_pz.simulator.kernels.state import Distances, State, World, planning_view_of

_CLASS_BIT = 56
"""The first bit of an option after those of its operation and its cost."""


class Intentions(NamedTuple):
    """The operations of N agents in B environments between steps: the fields of `EpibtState` of the same names."""

    choice: Array  # (B, N) int32
    cell: Array  # (B, N) int32
    heading: Array  # (B, N) int32


@jit
def choose_by_epibt(
    world: World,
    distances: Distances,
    state: State,
    patience: int,
    preferences: Array,
    progress: Progress,
    tree: Operations,
    intentions: Intentions,
    scratch: EpibtState,
    actions: Array,
) -> None:
    """Write actions (B, N) int64 of agents that turn such that no move is blocked.

    Args:
        world: the maps.
        distances: the cost to go to the goals of all agents.
        state: the state of the B environments.
        patience: the number of steps without progress after which an agent follows EPIBT for as many steps; 0: never.
        preferences: (B, N, 4) float64, higher for better actions.
        progress: of all agents.
        tree: the operations.
        intentions: of all agents.
        scratch: the state of EPIBT for one environment.
        actions: the output.
    """
    for b in range(actions.shape[0]):
        planning_view = planning_view_of(world, distances, state, b)
        agents = planning_view.agents
        copy_row(intentions.choice[b], scratch.choice)
        copy_row(intentions.cell[b], scratch.cell)
        copy_row(intentions.heading[b], scratch.heading)
        continue_operations(agents, tree, scratch)
        evaluate(planning_view, True, tree, scratch)
        for i in range(agents.size):
            count_steps(planning_view, i, patience, progress.nearest[b], progress.count[b])
            if agents[i].active and not is_stuck(progress.count[b, i], patience):
                _prefer(i, preferences[b, i], tree, scratch)
        decide(agents, scratch)
        first_actions(agents, tree, scratch, actions[b])
        intentions.choice[b], intentions.cell[b] = scratch.choice, scratch.cell
        intentions.heading[b] = scratch.heading


@jit
def _prefer(i: int, preferences: Array, tree: Operations, state: EpibtState) -> None:
    """Sort the options of agent i by its preferences (4,) for their first actions, then as in EPIBT.

    Operations without a move that are no options in EPIBT are added.
    """
    for p in range(tree.num_regular, tree.nodes.shape[0]):
        _add_option(i, p, preferences, tree, state)
    _add_option(i, tree.wait, preferences, tree, state)
    options = state.options[i, : state.num_options[i]]
    for k in range(options.size):
        action = tree.action[tree.nodes[options[k] & LAST_OPERATION, 0]]
        options[k] |= num_better(preferences, action) << _CLASS_BIT
    options.sort()


@jit
def _add_option(i: int, p: int, preferences: Array, tree: Operations, state: EpibtState) -> None:
    """Add operation p to the options of agent i if the agent prefers its first action to another one."""
    if preferences[tree.action[tree.nodes[p, 0]]] > preferences.min():
        state.options[i, state.num_options[i]] = pack_option(state.cost[i, p], p)
        state.num_options[i] += 1
