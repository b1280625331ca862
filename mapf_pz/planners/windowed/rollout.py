"""Paths from a simulation of PIBT, which makes progress even where all agents are in each other's way.

An agent that passes its goal in the simulation then heads for the goal of a random agent, as its own next goal is not
known yet.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapf_pz._internal.jit import Array, jit
from mapf_pz.planners.copying import copy_row
from mapf_pz.planners.pibt.kernels import plan
from mapf_pz.planners.pibt.state import NEAREST, NO_AGENT, UNDECIDED, Options, PibtState, allocate_pibt
from mapf_pz.planners.random import draw_below
from mapf_pz.planners.windowed.paths import Paths, allocate_paths, cost_of_path, facing, occupy
from mapf_pz.simulator.kernels.conflict import NO_MOVE, direction
from mapf_pz.simulator.kernels.cost_lookup import num_headings, turned
from mapf_pz.simulator.kernels.state import PlanningView

OPTIONS = Options(priority=NEAREST, swap=True, hindrance=True)
"""The options of PIBT."""


class Rollout(NamedTuple):
    """The simulated agents, and the paths that they take."""

    agents: Array  # (N,) AGENT
    occupant: Array  # (C + 1,) int32
    actions: Array  # (N,) int64
    pibt: PibtState
    paths: Paths  # `used` and `least` are not kept up to date


def allocate_rollout(planning_view: PlanningView, window: int, seed: int) -> Rollout:
    """Allocate a rollout over `window` steps; `seed`, which must not be 0, breaks ties of PIBT."""
    return Rollout(
        agents=planning_view.agents.copy(),
        occupant=planning_view.occupant.copy(),
        actions=np.zeros(planning_view.agents.size, np.int64),
        pibt=allocate_pibt(planning_view.agents.size, planning_view.occupant.size - 1, seed),
        paths=allocate_paths(planning_view, window),
    )


@jit
def roll_out(planning_view: PlanningView, passing: bool, random: Array, rollout: Rollout) -> float:
    """Write paths to `rollout.paths`, and return the sum of their costs."""
    agents, paths = rollout.agents, rollout.paths
    view = PlanningView(
        planning_view.leads_to,
        planning_view.weight,
        planning_view.slot,
        planning_view.to_go,
        agents,
        rollout.occupant,
    )
    rollout.pibt.want[:] = UNDECIDED
    for i in range(agents.size):
        agents[i] = planning_view.agents[i]
    for t in range(paths.cell.shape[1]):
        if t > 0:
            plan(view, passing, OPTIONS, rollout.pibt, rollout.actions)
            _move(view, rollout.actions)
        rollout.occupant[:] = NO_AGENT
        for i in range(agents.size):
            paths.cell[i, t], paths.heading[i, t] = agents[i].cell, facing(planning_view, agents[i])
            if agents[i].active:
                rollout.occupant[agents[i].cell] = i
            if passing and t > 0 and agents[i].cell == agents[i].goal:
                agents[i].goal = planning_view.agents[draw_below(random, agents.size)].goal
    total = 0.0
    for i in range(agents.size):
        if agents[i].active:
            paths.cost[i] = cost_of_path(planning_view, i, passing, paths)
            total += paths.cost[i]
    return total


@jit
def _move(view: PlanningView, actions: Array) -> None:
    """Execute actions (N,) without collisions."""
    cardinal = num_headings(view.to_go) == 1
    for i in range(actions.size):
        agent = view.agents[i]
        towards = direction(cardinal, agent.heading, actions[i])
        if towards != NO_MOVE:
            agent.cell = view.leads_to[towards, agent.cell]
        elif not cardinal:
            agent.heading = turned(agent.heading, actions[i])


@jit
def take_rollout(rollout: Rollout, paths: Paths) -> None:
    """Replace the paths of all agents by those of the rollout."""
    paths.used[:] = NO_AGENT
    copy_row(rollout.paths.cost, paths.cost)
    for i in range(paths.cost.size):
        copy_row(rollout.paths.cell[i], paths.cell[i])
        copy_row(rollout.paths.heading[i], paths.heading[i])
        if rollout.agents[i].active:
            occupy(paths, i)
