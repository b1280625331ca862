"""Conflict-based search: plans with the lowest sum of costs."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np

from mapf_pz.environment.mapf_env import MapfEnv
from mapf_pz.planners.base import PlanFollower
from mapf_pz.planners.cbs.tree import AgentPath, ConflictTree, cells_of, padded
from mapf_pz.planners.deadline import Deadline
from mapf_pz.planners.problem import Path, Problem, obstruction, problem_of
from mapf_pz.simulator.kernels.cost_lookup import num_headings
from mapf_pz.simulator.simulator import Simulator


class CBS(PlanFollower):
    """Finds plans with the lowest sum of costs, for both action models; for small instances.

    Conflict-based search (Sharon et al., Artificial Intelligence 219, 2015) plans each agent alone. If two paths
    collide, it continues with two problems, in which one or the other agent must not be there at that time, in the
    order of a lower bound on their costs. It chooses conflicts that raise the cost first, and replaces a path where
    that is enough (Boyarski et al., IJCAI 2015). It adds to the bound the number of disjoint pairs of agents with such
    conflicts (Felner et al., ICAPS 2018). Agents that conflict often, as in a corridor, are merged and planned together
    by A* over their joint states, and the search starts again (MA-CBS in the first, "merge and restart" in the second
    article). The time grows exponentially with the number of conflicts and with the number of agents of a group.

    The sum of costs counts steps, whatever the edge weights are; edges of infinite weight are blocked.
    """

    optimal: ClassVar[bool] = True

    def __init__(
        self,
        env: MapfEnv | None = None,
        seed: int = 0,
        time_limit: float = 1.0,
        execution: str = "replan",
        max_lateness: int = 5,
    ) -> None:
        """Create the planner.

        Args:
            env: the environment to act in, or a wrapper of it. With None, only `solve` can be used.
            seed: random seed, which has no effect.
            time_limit: time limit in seconds of each call of `act` that has to plan.
            execution: what to do when agents are delayed: see `PlanFollower`.
            max_lateness: with `both`, by how many steps an agent is late that needs another plan: see `PlanFollower`.

        Raises `ValueError` for an unknown execution, and a `max_lateness` below 1.
        """
        super().__init__(env, seed, time_limit, anytime=False, execution=execution, max_lateness=max_lateness)

    def plan(self, problem: Problem, time_limit: float) -> Path | None:
        """Return the paths with the lowest sum of costs; None: they were not found in time, or there are none."""
        deadline = Deadline(time_limit, self.clock)
        if obstruction(problem) is not None:
            return None
        tree = ConflictTree(problem)
        paths = tree.search(deadline)
        if paths is not None:
            return _joined(paths, num_headings(problem.to_go))
        if tree.is_exhausted:
            self.unsolvable = "the search has excluded all paths"
        return None

    def _call_kernels(self, simulator: Simulator) -> None:
        super()._call_kernels(simulator)
        problem = problem_of(simulator)
        ConflictTree(problem, [tuple(range(len(problem.goals)))]).search(Deadline(math.inf))


def _joined(paths: list[AgentPath], headings: int) -> Path:
    """Return the paths of all agents."""
    turns = headings == 4
    return Path(cells_of(paths), padded([path.headings for path in paths]).astype(np.int8) if turns else None)
