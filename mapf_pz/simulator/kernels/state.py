"""The arrays that the kernels work on: `B` environments, `N` agents, `M` maps, `C = H * W` cells.

Arrays over cells have one more entry, the number `C`: it stands for everything outside the map, so that a view that
sticks out of the map is read without branches.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba.extending import register_jitable

from mapf_pz._internal.jit import Array, jit, numba_config

Fields = tuple[Any, ...]
"""The fields of a named tuple as a plain tuple, which takes much less time to pass to a kernel."""

AGENT = np.dtype(
    [
        ("cell", np.int32),
        ("goal", np.int32),
        ("heading", np.int32),
        ("table", np.int32),  # the cost-to-go table that its observation and reward are computed from
        ("active", np.bool_),  # False once it has disappeared at its goal
        # Before the last step:
        ("was_active", np.bool_),
        ("was_cell", np.int32),
        ("was_goal", np.int32),
        ("was_heading", np.int32),
        # What the last step brought:
        ("at_goal", np.bool_),  # it ended on its goal
        ("arrived", np.bool_),  # it was an arrival (with `nothing`: the first one) at a goal
        ("blocked", np.bool_),  # a move was wanted and did not happen
        ("terminated", np.bool_),
        ("truncated", np.bool_),
        ("delayed", np.bool_),  # it was delayed, and waited
        ("step_weight", np.float32),  # of the edge that it took, or of waiting or turning; 0 once it has disappeared
        ("progress", np.float32),  # the fall of the cost to go, where the reward asks for it
        ("own_reward", np.float64),  # before sharing
        ("reward", np.float64),
        # Since the episode began:
        ("arrivals", np.int32),  # goals reached
        ("resting_since", np.int32),  # the step since which it is on its goal; -1: it is not
        ("path_weight", np.float64),  # the sum of `step_weight`
        ("weighted_cost", np.float64),  # that sum up to the step `resting_since`, or of all steps if it is -1
        ("delay", np.int32),  # the number of following steps in which it is still delayed
        # Scratch:
        ("want", np.int32),  # the cell it wants, then the cell it gets
        ("next_cell", np.int32),  # the next cell on its own cheapest path; -1: none
        ("closer", np.int32),  # bit `k`: a move in direction `k` leads closer to its goal
    ],
    align=True,
)
"""One agent. Kernels take the agents of one environment as `agents` (N,) AGENT."""


class World(NamedTuple):
    """What never changes during an episode: M maps of one size and their guidance graphs."""

    height: int
    width: int
    leads_to: Array  # (M, 4, C + 1) int32: the cell that a move in each direction ends in; the own cell if blocked
    weight: Array  # (M, 5, C + 1) float32: of leaving in each direction (inf: blocked), and of waiting or turning
    obstacle: Array  # (M, C + 1) float32: 1 on obstacles and outside, 0 on free cells
    mean_weight: Array  # (M,) float32: mean of the finite weights of moving and waiting on free cells
    equal_weight: Array  # (M,) float32: the one weight of all edges and waits; 0 where they differ


WAIT_WEIGHT = 4  # the plane of `World.weight` after the four headings


class CostToGo(NamedTuple):
    """S cost-to-go tables in one of two forms, the other of which is empty; `D` headings (4, or 1 for cardinal agents).

    Kernels read them by the functions of `mapf_pz.simulator.kernels.cost_lookup`.
    """

    packed: Array  # (S, C + 1) uint32: where all weights are 1: the steps to the goal from all headings of a cell
    exact: Array  # (S, C + 1, D) float32: otherwise: the cheapest cost from a cell and heading; inf: unreachable
    least: Array  # (S, C + 1) float32: the least of `exact` over headings


class Distances(NamedTuple):
    """The fields of `CostToGo`, with one table per map and goal in use, and where each is."""

    slot: Array  # (M, C + 1) int32: which table belongs to the goal; -1: none yet
    packed: Array  # (S, C + 1) uint32
    exact: Array  # (S, C + 1, D) float32
    least: Array  # (S, C + 1) float32


class PlanningView(NamedTuple):
    """One environment, its map and the cost to go to its agents' goals: what planners look at."""

    leads_to: Array  # (4, C + 1) int32
    weight: Array  # (5, C + 1) float32
    slot: Array  # (C + 1,) int32
    to_go: CostToGo
    agents: Array  # (N,) AGENT
    occupant: Array  # (C + 1,) int32


class State(NamedTuple):
    """What changes from step to step."""

    map: Array  # (B,) int32: which of the M maps each environment is on
    time: Array  # (B,) int32: steps taken in this episode
    agents: Array  # (B, N) AGENT
    terminated: Array  # (B,) bool: the episode is over, as all agents are at their goals or have disappeared
    truncated: Array  # (B,) bool: it is over, as its time is up
    goals: Array  # (B, N, G) int32: each agent's goals in order
    history: Array  # (B, N, L, 2) int8: the last L actions, newest first, and whether they moved; action -1: none
    occupant: Array  # (B, C + 1) int32: the agent on each cell; -1: none
    claim: Array  # (B, C + 1) int32: scratch of the conflict kernels, -1 between steps
    delay_key: Array  # (B,) uint64: what the delays of each episode depend on


@register_jitable
def planning_view_of(world: World, distances: Distances, state: State, b: int) -> PlanningView:
    """Return environment `b` as planners read it; kernels call this, too."""
    m = state.map[b]
    return PlanningView(
        world.leads_to[m],
        world.weight[m],
        distances.slot[m],
        CostToGo(distances.packed, distances.exact, distances.least),
        state.agents[b],
        state.occupant[b],
    )


def allocate_state(num_envs: int, num_agents: int, num_cells: int, num_goals: int, remembered: int) -> State:
    """Make room for B environments of N agents on C cells, G goals each, remembering L actions."""
    agents = np.zeros((num_envs, num_agents), AGENT)
    return State(
        map=np.zeros(num_envs, np.int32),
        time=np.zeros(num_envs, np.int32),
        # Compiled kernels read fields as attributes; plain Python needs a record array for that.
        agents=agents.view(np.recarray) if numba_config.DISABLE_JIT else agents,
        terminated=np.zeros(num_envs, np.bool_),
        truncated=np.zeros(num_envs, np.bool_),
        goals=np.zeros((num_envs, num_agents, num_goals), np.int32),
        history=np.zeros((num_envs, num_agents, remembered, 2), np.int8),
        occupant=np.full((num_envs, num_cells + 1), -1, np.int32),
        claim=np.full((num_envs, num_cells + 1), -1, np.int32),
        delay_key=np.zeros(num_envs, np.uint64),
    )


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


class Rules(NamedTuple):
    """The configuration, as the kernels take it."""

    cardinal: bool
    collision: int
    on_target: int
    max_steps: int
