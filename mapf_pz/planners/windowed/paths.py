"""The paths of all agents over the next T steps, which are free of collisions at any time.

No two paths end on the same cell. So if every agent continues its path after a step, and waits at the end of it, the
paths are free of collisions again.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapf_pz._internal.jit import Array, jit
from mapf_pz.planners.copying import copy_row
from mapf_pz.planners.pibt.state import NO_AGENT, to_go
from mapf_pz.simulator.kernels.cost_lookup import num_headings
from mapf_pz.simulator.kernels.state import WAIT_WEIGHT, PlanningView


class Paths(NamedTuple):
    """The paths of N agents on C cells over T steps."""

    cell: Array  # (N, T + 1) int32: the cells, starting with the current one; -1: no path yet
    heading: Array  # (N, T + 1) int32: the headings; 0 for cardinal agents
    cost: Array  # (N,) float32: cost of the path and cost to go from its end; up to its goal if the agent passes it
    least: Array  # (N,) float32: a lower bound of `cost`: the cost of the best path of the agent if it were alone
    used: Array  # (T + 1, C + 1) int32: the agent on each cell after each step; -1: none
    fixed: Array  # (N,) bool: agents with whose paths no other path may collide, even for a short time


def allocate_paths(planning_view: PlanningView, window: int) -> Paths:
    """Allocate the paths over `window` steps for an environment."""
    num_agents, cells = planning_view.agents.size, planning_view.occupant.size
    return Paths(
        cell=np.full((num_agents, window + 1), -1, np.int32),
        heading=np.zeros((num_agents, window + 1), np.int32),
        cost=np.zeros(num_agents, np.float32),
        least=np.zeros(num_agents, np.float32),
        used=np.full((window + 1, cells), NO_AGENT, np.int32),
        fixed=np.zeros(num_agents, np.bool_),
    )


@jit
def continue_paths(planning_view: PlanningView, passing: bool, paths: Paths) -> None:
    """Let each agent continue its path.

    If any agent is not in the expected state (new episode, different rules), all of them wait, which is always legal.
    With `passing`, an agent only has to pass its goal; otherwise it must stay there.
    """
    agents, last = planning_view.agents, paths.cell.shape[1] - 1
    # The first step of every path must have been executed. If even one agent did something else, the other paths may
    # lead through it, so none of them can be kept.
    as_planned = True
    for i in range(agents.size):
        if agents[i].active:
            heading = facing(planning_view, agents[i])
            as_planned &= paths.cell[i, 1] == agents[i].cell and paths.heading[i, 1] == heading
    paths.used[:] = NO_AGENT
    for i in range(agents.size):
        if agents[i].active and as_planned:
            copy_row(paths.cell[i, 1:], paths.cell[i, :last])
            copy_row(paths.heading[i, 1:], paths.heading[i, :last])
        else:
            paths.cell[i], paths.heading[i] = agents[i].cell, facing(planning_view, agents[i])
        if agents[i].active:
            occupy(paths, i)
            paths.least[i] = _least_cost(planning_view, agents[i], passing)
            paths.cost[i] = cost_of_path(planning_view, i, passing, paths)


@jit
def facing(planning_view: PlanningView, agent: Array) -> int:
    """Return the heading of an agent, or 0 if it is a cardinal agent."""
    return agent.heading & (num_headings(planning_view.to_go) - 1)


@jit
def _least_cost(planning_view: PlanningView, agent: Array, passing: bool) -> np.float32:
    """Return the cost of the best path of an agent if it were alone.

    An arrival takes a step. So an agent that is on a goal it has to pass must wait there, turn, or leave and return.
    """
    if not passing or agent.cell != agent.goal:
        return to_go(planning_view, agent, agent.cell, agent.heading)
    least = planning_view.weight[WAIT_WEIGHT, agent.cell]
    for direction in range(4):
        if num_headings(planning_view.to_go) == 1 or direction == agent.heading:
            there = planning_view.leads_to[direction, agent.cell]
            cost = planning_view.weight[direction, agent.cell] + to_go(planning_view, agent, there, agent.heading)
            least = min(least, cost)
    return least


@jit
def cost_of_path(planning_view: PlanningView, i: int, passing: bool, paths: Paths) -> float:
    """Return the cost of agent i's path, as in `Paths.cost`."""
    agent, weight, last = planning_view.agents[i], planning_view.weight, paths.cell.shape[1] - 1
    cell, heading, cost = paths.cell[i], paths.heading[i], 0.0
    for t in range(last):
        here, there = cell[t], cell[t + 1]
        # At t = 0 the agent has not passed its goal yet: see `_least_cost`.
        if passing and here == agent.goal and t > 0:
            return cost
        if here != there:
            for direction in range(4):
                if planning_view.leads_to[direction, here] == there:
                    cost += weight[direction, here]
        elif passing or here != agent.goal or heading[t] != heading[t + 1]:
            cost += weight[WAIT_WEIGHT, here]
    return cost + float(to_go(planning_view, agent, cell[last], heading[last]))


@jit
def occupy(paths: Paths, i: int) -> None:
    """Mark the cells of agent i's path as used."""
    for t in range(paths.cell.shape[1]):
        paths.used[t, paths.cell[i, t]] = i


@jit
def release(paths: Paths, i: int) -> None:
    """Mark the cells of agent i's path as not used."""
    for t in range(paths.cell.shape[1]):
        paths.used[t, paths.cell[i, t]] = NO_AGENT


@jit
def colliding_agent(used: Array, t: int, here: int, there: int, swapping: bool) -> int:
    """Return the agent with which a move from `here` to `there` in step `t` collides, or -1.

    This is the agent that is on `there` after the step, or, with `swapping`, the one that moves from there to `here`.
    """
    if not swapping:
        return used[t, there]
    other = used[t - 1, there]
    return other if here != there and other != NO_AGENT and used[t, here] == other else NO_AGENT
