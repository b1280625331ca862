"""A walk toward the goals of a one-shot problem: plan a window, take a step, and so on.

The paths are short, but agents that have arrived may stay in the way of others, which then never arrive.
"""

from __future__ import annotations

import math

import numpy as np

from mapf_pz.planners.deadline import Deadline
from mapf_pz.planners.problem import Path, Problem
from mapf_pz.planners.windowed.improve import allocate_neighborhood, improve
from mapf_pz.planners.windowed.paths import allocate_paths, continue_paths
from mapf_pz.planners.windowed.search import allocate_search
from mapf_pz.simulator.kernels.cost_lookup import num_headings
from mapf_pz.simulator.kernels.state import AGENT, PlanningView

WINDOW = 20
"""Number of steps to plan."""
ROUNDS = 0.5
"""Mean number of attempts to improve the path of each agent in a step. More of them take longer than they are worth."""

SECONDS_PER_AGENT_STEP = 4e-6
"""Work of a step of an agent; the time is half of it where agents are sparse, and up to three times where dense."""


def walk(problem: Problem, rng: np.random.Generator, deadline: Deadline) -> Path:
    """Return paths without collisions; agents may end away from their goals.

    The walk ends when all agents are at their goals, when for `WINDOW` steps no more of them were than before, or at
    the deadline.
    """
    num_agents, num_cells = len(problem.goals), problem.leads_to.shape[1]
    agents = np.zeros(num_agents, AGENT)
    agents["cell"], agents["heading"], agents["goal"] = problem.starts, problem.headings, problem.goals
    agents["active"] = True
    slot = np.full(num_cells, -1, np.int32)
    slot[problem.goals] = problem.table
    occupant = np.full(num_cells, -1, np.int32)
    view = PlanningView(problem.leads_to, problem.weight, slot, problem.to_go, agents, occupant)
    paths, scratch = allocate_paths(view, WINDOW), allocate_search(WINDOW, num_headings(problem.to_go))
    neighborhood = allocate_neighborhood(WINDOW, int(rng.integers(1, 2**63)))
    mean_weight = float(problem.weight[np.isfinite(problem.weight)].mean())
    cells, headings = [agents["cell"].copy()], [agents["heading"].astype(np.int8)]
    attempts = math.ceil(ROUNDS * num_agents)
    most, since = 0, 0
    while most < num_agents and since < WINDOW and not deadline.has_passed:
        continue_paths(view, False, paths)
        improve(view, False, mean_weight, attempts, paths, scratch, neighborhood)
        deadline.count(SECONDS_PER_AGENT_STEP * num_agents)
        agents["cell"], agents["heading"] = paths.cell[:, 1], paths.heading[:, 1]
        cells.append(paths.cell[:, 1].copy())
        headings.append(paths.heading[:, 1].astype(np.int8))
        arrived = int((agents["cell"] == problem.goals).sum())
        since = 0 if arrived > most else since + 1
        most = max(most, arrived)
    return Path(np.stack(cells), np.stack(headings) if num_headings(problem.to_go) == 4 else None)
