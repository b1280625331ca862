"""Prioritized planning: plan the agents sequentially, each with the earliest arrival given the paths before it."""

from __future__ import annotations

import numpy as np

from mapf_pz.planners.base import PlanFollower
from mapf_pz.planners.deadline import Deadline
from mapf_pz.planners.problem import Path, Problem, obstruction, starting_costs
from mapf_pz.planners.sipp.refine import NeighborhoodSearch

PATIENCE = 100
"""Number of calls to `improve` without progress on missing paths before all agents are replanned."""


class PrioritizedSIPP(PlanFollower):
    """Plans the agents with the longest paths first, by SIPP (`mapf_pz.planners.sipp.search`); for both action models.

    Agents that are left without a path are replanned together with those in their way
    (`mapf_pz.planners.sipp.improve`). If this does not help for some time, all agents are replanned in a random order.
    The planner is incomplete: it may find no plan although there is one.
    """

    def plan(self, problem: Problem, time_limit: float) -> Path | None:
        """Return paths that bring all agents to their goals, or None if none were found in time."""
        if obstruction(problem) is not None:
            return None
        shortest = starting_costs(problem)
        search = NeighborhoodSearch(problem, self._rng)
        deadline = Deadline(time_limit, self.clock)
        order = np.argsort(-shortest, kind="stable")
        while search.missing and not deadline.has_passed:
            search.plan_all(order, deadline)
            fewest, since = search.missing, 0
            while search.missing and since < PATIENCE and not deadline.has_passed:
                deadline.count(search.improve())
                since = 0 if search.missing < fewest else since + 1
                fewest = min(fewest, search.missing)
            order = self._rng.permutation(len(order))
        if search.missing:
            return None
        self.trace.add(search.sum_of_costs)
        while self._anytime and not search.is_shortest and not deadline.has_passed:
            deadline.count(search.improve())
            self.trace.add(search.sum_of_costs)
        return search.path()
