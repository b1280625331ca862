"""LaCAM as a planner and as a policy: complete, and fast even on crowded maps."""

from __future__ import annotations

import math
from typing import TypeVar

import numpy as np

from mapf_pz._internal.arrays import Ints
from mapf_pz.planners.base import PlanFollower
from mapf_pz.planners.deadline import Deadline
from mapf_pz.planners.hashing import refill_slots
from mapf_pz.planners.lacam import schedule
from mapf_pz.planners.lacam import search as lacam
from mapf_pz.planners.lacam.step import allocate_scratch
from mapf_pz.planners.problem import Path, Problem, problem_of, starting_costs
from mapf_pz.planners.sipp.refine import NeighborhoodSearch, refine
from mapf_pz.planners.windowed.walk import walk
from mapf_pz.simulator.kernels.cost_lookup import num_headings
from mapf_pz.simulator.kernels.cost_tables import CostTables
from mapf_pz.simulator.kernels.state import CostToGo
from mapf_pz.simulator.kernels.world import allocate
from mapf_pz.simulator.simulator import Simulator

MAX_BYTES = 1 << 30
"""Maximum memory of a search, which fails if it needs more."""

WALK_SHARE = 0.9
"""Share of the time after the first solution in which to walk."""
REPAIR = 2.0
"""Time to plan the agents again that have not arrived at the end of the walk, as a multiple of the time of the walk."""

SECONDS_PER_AGENT_STEP = 1e-6
"""Work of the search over configurations, for each agent of a configuration."""

_AGENT_STEPS = 50_000  # per call of the kernel: about 50 ms

Buffers = TypeVar("Buffers", lacam.Nodes, lacam.Constraints)


class LaCAM(PlanFollower):
    """Plans whole paths by a search over configurations, for both action models: see `mapf_pz.planners.lacam.search`.

    Given enough time and memory, it solves every solvable instance. Time that is left is used to find shorter paths
    (`mapf_pz.planners.windowed.walk`), and to shorten them (`mapf_pz.planners.sipp.refine`). The search uses at most
    `MAX_BYTES`, and temporarily half as much again while its arrays grow.
    """

    def plan(self, problem: Problem, time_limit: float) -> Path | None:
        """Return paths that bring all agents to their goals, or None if none were found.

        If agents that stay share a goal, only the nearest of them has to reach it. None means that the search ran out
        of time or memory, or that it has visited all configurations.
        """
        if not np.isfinite(starting_costs(problem)).all():
            return None
        claimed = problem.goals if problem.disappear else _claimed_goals(problem)
        # The search over configurations ignores turns; a schedule of its result adds them.
        search = ConfigurationSearch(_without_turns(problem)._replace(goals=claimed), self._rng)
        improving = self._anytime and (claimed != lacam.NONE).all()
        refinement = NeighborhoodSearch(problem, self._rng) if improving else None
        deadline = Deadline(time_limit, self.clock)
        cells = search.run(deadline)
        if cells is None:
            if search.is_exhausted:
                self.unsolvable = "the search has visited all configurations"
            return None
        path = _to_path(problem, cells)
        if refinement is None:
            return path
        self.trace.add(path.sum_of_costs)
        if not problem.disappear:  # on a walk, agents stay at their goals
            path = self._shorten(path, problem, refinement, deadline)
            self.trace.add(path.sum_of_costs)
        return refine(refinement, path, deadline, self.trace)

    def _shorten(self, path: Path, problem: Problem, search: NeighborhoodSearch, deadline: Deadline) -> Path:
        """Return the solution `path`, or a shorter one that starts with a walk: see `mapf_pz.planners.windowed.walk`.

        The agents that have not arrived at the end of the walk are planned again from their starts, by `search`. If
        there is no time for this, the search over configurations continues from the end of the walk.
        """
        seconds = deadline.seconds_left
        search.set_paths(path)
        if seconds <= 0 or search.is_shortest:
            return path
        cost = search.sum_of_costs
        walked = walk(problem, self._rng, Deadline(WALK_SHARE * seconds, self.clock))
        completed = self._complete(walked, problem, deadline)
        if completed is not None:
            search.set_paths(completed)
            if search.sum_of_costs < cost:
                path, cost = completed, search.sum_of_costs
                self.trace.add(cost)
        search.set_arriving_paths(walked)
        # Both ways are tried: to complete the walk is certain, given the time, but to plan the late agents again is
        # cheaper.
        search.plan_missing(deadline.earlier(REPAIR * (seconds - deadline.seconds_left)))
        return path if search.missing or search.sum_of_costs >= cost else search.path()

    def _complete(self, path: Path, problem: Problem, deadline: Deadline) -> Path | None:
        """Return `path`, continued until all agents are at their goals, or None if that is not possible in time."""
        headings = problem.headings if path.headings is None else path.headings[-1].astype(np.int32)
        rest = problem._replace(starts=path.cells[-1].copy(), headings=headings)
        cells = ConfigurationSearch(_without_turns(rest), self._rng).run(deadline)
        if cells is None:
            return None
        end = _to_path(rest, cells)
        return Path(
            np.concatenate([path.cells, end.cells[1:]]),
            None
            if path.headings is None or end.headings is None
            else np.concatenate([path.headings, end.headings[1:]]),
        )

    def _call_kernels(self, simulator: Simulator) -> None:
        super()._call_kernels(simulator)
        problem = problem_of(simulator)
        ConfigurationSearch(_without_turns(problem), self._rng).double_nodes()
        if self._anytime:
            search = NeighborhoodSearch(problem, self._rng)
            never = Deadline(math.inf)
            search.plan_all(np.arange(len(problem.goals)), never)
            path = search.path()
            search.set_arriving_paths(path._replace(cells=path.cells[:1]))
            search.plan_missing(never)
            walk(problem, self._rng, never)


def _claimed_goals(problem: Problem) -> Ints:
    """Return each agent's goal (N,) int32; -1 if another agent is nearer to the same goal."""
    nearest_first = np.argsort(starting_costs(problem), kind="stable")
    _, first = np.unique(problem.goals[nearest_first], return_index=True)
    claiming = nearest_first[first]
    goals = np.full_like(problem.goals, lacam.NONE)
    goals[claiming] = problem.goals[claiming]
    return goals


class ConfigurationSearch:
    """A search over configurations, for cardinal agents or for agents whose turns are free."""

    def __init__(self, problem: Problem, rng: np.random.Generator) -> None:
        """Start the search at the first configuration."""
        num_agents, num_cells = len(problem.goals), problem.leads_to.shape[1] - 1
        cost = np.where(problem.goals == lacam.NONE, -1, starting_costs(problem))
        # Agents with long ways have priority at first, as they decide when the last agent arrives.
        farthest_first = np.argsort(-cost, kind="stable").astype(np.int32)
        self._problem = problem
        self._outside = num_cells
        self._ends = np.full_like(problem.goals, self._outside) if problem.disappear else problem.goals
        self._scratch = allocate_scratch(num_agents, num_cells, int(rng.integers(1, 2**63)))
        self._nodes, self._constraints = lacam.allocate_nodes(1 << 10, num_agents), lacam.allocate_constraints(1 << 13)
        self._counters = np.zeros(4, np.int64)
        self._status = lacam.start(
            problem, self._ends, farthest_first, self._nodes, self._constraints, self._scratch, self._counters
        )

    def run(self, deadline: Deadline) -> Ints | None:
        """Return the cells (T + 1, N) of the configurations from the start to the goals, or None.

        Agents that have disappeared are on their goals.
        """
        iterations = 1 + _AGENT_STEPS // len(self._problem.goals)
        while self._status in (lacam.RUNNING, lacam.FULL) and not deadline.has_passed:
            if self._status == lacam.FULL and not self._grow():
                return None
            known = int(self._counters[lacam.NUM_NODES])
            self._status = lacam.search(
                self._problem, self._ends, iterations, self._nodes, self._constraints, self._scratch, self._counters
            )
            # Work is counted by iterations, so that a clock of work does not depend on the machine.
            found = int(self._counters[lacam.NUM_NODES]) - known
            steps = iterations if self._status == lacam.RUNNING else found
            deadline.count(SECONDS_PER_AGENT_STEP * steps * len(self._problem.goals))
        if self._status != lacam.SOLVED:
            return None
        chain = [int(self._counters[lacam.SOLUTION])]
        while self._nodes.parent[chain[-1]] != lacam.NONE:
            chain.append(int(self._nodes.parent[chain[-1]]))
        cells = self._nodes.rows[chain[::-1]]
        return np.where(cells == self._outside, self._problem.goals, cells)

    @property
    def is_exhausted(self) -> bool:
        """Whether all configurations have been visited, so that there is no solution."""
        return self._status == lacam.EXHAUSTED

    def _grow(self) -> bool:
        """Double the capacity of what is full; return whether that is allowed."""
        if 2 * sum(array.nbytes for array in (*self._nodes, *self._constraints)) > MAX_BYTES:
            return False
        if self._counters[lacam.NUM_NODES] == len(self._nodes.parent):
            self.double_nodes()
        else:
            self._constraints = _doubled(self._constraints)
        return True

    def double_nodes(self) -> None:
        """Double the capacity for configurations."""
        self._nodes = _doubled(self._nodes)
        refill_slots(self._nodes, self._counters[lacam.NUM_NODES])


def _without_turns(problem: Problem) -> Problem:
    """Return the relaxed problem in which turns are free."""
    if num_headings(problem.to_go) == 1:
        return problem
    num_cells = problem.leads_to.shape[1]
    is_open = problem.leads_to != np.arange(num_cells)
    world = allocate(1, ((num_cells - 1) // problem.width, problem.width))
    world.leads_to[0], world.weight[0], world.obstacle[0] = problem.leads_to, problem.weight, ~is_open.any(axis=0)
    costs = problem.weight[:4][is_open]
    world.equal_weight[0] = costs[0] if len(np.unique(costs)) == 1 else 0
    unit_weights = bool(world.equal_weight[0] == 1)
    max_bytes = 8 * num_cells * len(problem.goals)
    tables = CostTables(world, 1, len(problem.goals), unit_weights, max_bytes)
    tables.require(np.zeros(1, np.int32), problem.goals[None])
    slot, *to_go = tables.arrays
    table = slot[0][problem.goals]
    return problem._replace(to_go=CostToGo(*to_go), table=table, headings=np.zeros_like(problem.headings))


def _doubled(buffers: Buffers) -> Buffers:
    return buffers._make(np.concatenate([array, np.zeros_like(array)]) for array in buffers)


def _to_path(problem: Problem, cells: Ints) -> Path:
    """Return paths through the configurations `cells` (T + 1, N), which are modified."""
    steps, num_agents = len(cells) - 1, cells.shape[1]
    rotates = num_headings(problem.to_go) == 4
    scratch = np.zeros((2, problem.leads_to.shape[1]), np.int32)
    at, intent = np.zeros(num_agents, np.int32), np.zeros(num_agents, np.int8)
    while schedule.cut_loops(cells, scratch[0], scratch[1]):
        pass
    visits = schedule.allocate_visits(cells)
    schedule.list_visits(cells, problem.leads_to, visits, at, scratch[0])
    rows = (3 if rotates else 1) * steps + 1
    path_cells, path_headings = np.tile(problem.starts, (rows, 1)), np.tile(problem.headings.astype(np.int8), (rows, 1))
    rows = schedule.schedule(visits, rotates, problem.disappear, path_cells, path_headings, at, intent) + 1
    return Path(path_cells[:rows], path_headings[:rows] if rotates else None)
