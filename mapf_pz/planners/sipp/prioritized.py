"""Prioritized planning: one agent after the other, each by the earliest way among the paths of those before it."""

from __future__ import annotations

import time

import numpy as np

from mapf_pz.planners.base import PlanFollower
from mapf_pz.planners.problem import Path, Problem
from mapf_pz.planners.sipp.refine import NeighborhoodSearch

PATIENCE = 100
"""How many slices of work may pass without more agents finding paths before all begin anew."""


class PrioritizedSIPP(PlanFollower):
    """Plans agents with a long way first, by safe intervals (`mapf_pz.planners.sipp.search`); for both action models.

    Agents that are left without a path are planned anew together with those in their way
    (`mapf_pz.planners.sipp.improve`). Where that does not help for a while, all begin anew in a random order. Incomplete:
    no plan does not mean that there is none.
    """

    def plan(self, problem: Problem, time_limit: float) -> Path | None:
        """Return where all agents are until they are at their goals, or None where that was not found in time."""
        shortest = problem.to_go[problem.table, problem.starts, problem.headings % problem.to_go.shape[2]]
        if np.isinf(shortest).any() or len(np.unique(problem.goals)) < len(problem.goals):
            return None
        search = NeighborhoodSearch(problem, self._rng)
        deadline = time.perf_counter() + time_limit
        order = np.argsort(-shortest, kind="stable")
        while search.missing and time.perf_counter() < deadline:
            search.begin_anew(order, deadline)
            fewest, since = search.missing, 0
            while search.missing and since < PATIENCE and time.perf_counter() < deadline:
                search.improve()
                since = 0 if search.missing < fewest else since + 1
                fewest = min(fewest, search.missing)
            order = self._rng.permutation(len(order))
        if search.missing:
            return None
        while self._anytime and not search.is_shortest and time.perf_counter() < deadline:
            search.improve()
        return search.path()
