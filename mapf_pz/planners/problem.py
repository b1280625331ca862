"""The input and the output of the planners' kernels: a one-shot problem, and the paths of all agents."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapf_pz._internal.arrays import Floats, Ints
from mapf_pz._internal.jit import Array
from mapf_pz.planners.plans.plan import costs_of
from mapf_pz.simulator.actions import Action, CardinalAction
from mapf_pz.simulator.kernels.cost_lookup import costs_at
from mapf_pz.simulator.kernels.state import CostToGo
from mapf_pz.simulator.simulator import Simulator


class Problem(NamedTuple):
    """A one-shot problem of N agents on a map of C cells; `D = 4` headings, or 1 for cardinal agents."""

    leads_to: Array  # (4, C + 1) int32: the cell that a move in each direction leads to; the same cell if blocked
    weight: Array  # (5, C + 1) float32: cost of moving in each direction (inf: blocked), and of waiting or turning
    to_go: CostToGo  # one table for each distinct goal
    table: Array  # (N,) int32: index of the table for each agent's goal
    starts: Array  # (N,) int32: cells
    headings: Array  # (N,) int32: at the start; 0 for cardinal agents
    goals: Array  # (N,) int32: cells
    width: int  # number of columns of the map
    disappear: bool  # whether agents leave the map after the step in which they arrive; otherwise they stay


def starting_costs(problem: Problem) -> Floats:
    """Return the cost to go (N,) float32 of each agent at its start; inf: it cannot reach its goal."""
    return costs_at(problem.to_go, problem.table, problem.starts, problem.headings)


def obstruction(problem: Problem) -> str | None:
    """Return why the problem has no solution, if that is plain without a search, else None."""
    unreachable = np.flatnonzero(np.isinf(starting_costs(problem)))
    if len(unreachable):
        return f"agent {unreachable[0]} cannot reach its goal"
    by_goal = np.argsort(problem.goals, kind="stable")
    same = np.flatnonzero(np.diff(problem.goals[by_goal]) == 0)
    if len(same) and not problem.disappear:
        one, other = by_goal[same[0]], by_goal[same[0] + 1]
        return f"agents {one} and {other} have the same goal"
    return None


class Path(NamedTuple):
    """The paths of N agents over T steps."""

    cells: Ints  # (T + 1, N) int32
    headings: Ints | None  # (T + 1, N) int8; None: cardinal agents

    @property
    def sum_of_costs(self) -> int:
        """Sum of the agents' costs, as in `Plan.costs`."""
        return int(costs_of(self.cells != self.cells[-1]).sum())

    def actions(self, leads_to: Ints) -> Ints:
        """Return the actions (T, N) int64 that follow these paths, on the map of `leads_to` (4, C + 1)."""
        here, there = self.cells[:-1], self.cells[1:]
        moved = here != there
        if self.headings is not None:
            turn = np.diff(self.headings.astype(np.int64), axis=0) % 4
            turned = np.select([turn == 1, turn == 3], [Action.ROTATE_RIGHT, Action.ROTATE_LEFT], Action.WAIT)
            return np.where(moved, Action.FORWARD, turned).astype(np.int64)
        actions = np.full(here.shape, CardinalAction.WAIT, np.int64)
        for direction, action in enumerate(CARDINAL_ACTIONS):
            actions[moved & (leads_to[direction][here] == there)] = action
        return actions


CARDINAL_ACTIONS = (CardinalAction.RIGHT, CardinalAction.DOWN, CardinalAction.LEFT, CardinalAction.UP)
"""The cardinal action that moves in the direction of each `Heading`."""


def problem_of(simulator: Simulator, b: int = 0) -> Problem:
    """Return the remaining problem of the active agents of environment `b`."""
    planning_view = simulator.planning_view(b)
    agents = planning_view.agents[planning_view.agents["active"]]
    cardinal = simulator.config.action_model == "cardinal"
    return Problem(
        leads_to=planning_view.leads_to,
        weight=planning_view.weight,
        to_go=planning_view.to_go,
        table=planning_view.slot[agents["goal"]],
        starts=agents["cell"].copy(),
        headings=np.zeros(len(agents), np.int32) if cardinal else agents["heading"].copy(),
        goals=agents["goal"].copy(),
        width=simulator.shape[1],
        disappear=simulator.config.on_target == "finish",
    )
