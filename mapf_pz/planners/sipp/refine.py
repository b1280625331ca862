"""Shorten the paths of a solution within a time limit."""

from __future__ import annotations

import numpy as np

from mapf_pz._internal.arrays import Ints
from mapf_pz.planners.deadline import Deadline
from mapf_pz.planners.problem import Path, Problem
from mapf_pz.planners.sipp.improve import allocate_lns, plan_and_improve
from mapf_pz.planners.sipp.neighborhood import allocate_neighborhood, sum_of_shortest
from mapf_pz.planners.sipp.reservations import NONE, allocate_reservations, discard, read_path, withdraw, write_path
from mapf_pz.planners.sipp.search import SippProblem, allocate_scratch
from mapf_pz.planners.trace import Trace
from mapf_pz.simulator.kernels.cost_lookup import UNREACHABLE, num_headings
from mapf_pz.simulator.kernels.cost_to_go import count_steps

WORK = 20_000
"""Number of states to expand between two checks of the clock: a few milliseconds."""
SECONDS_PER_STATE = 2e-7
"""Work of expanding a state."""
BATCH_SIZE = 16
"""Number of agents to plan between two checks of the clock."""
NO_AGENTS = np.zeros(0, np.int64)


def refine(search: NeighborhoodSearch, path: Path, deadline: Deadline, trace: Trace) -> Path:
    """Return the solution with the lowest sum of costs found in time, or `path` itself if none is better.

    It uses large neighborhood search: see `mapf_pz.planners.sipp.improve`.

    Args:
        search: a search for the problem that `path` solves.
        path: a valid solution, which ends with all agents at their goals.
        deadline: when to stop, which is checked every few milliseconds.
        trace: the solutions so far, to which better ones are added.
    """
    if deadline.has_passed:
        return path
    search.set_paths(path)
    before = search.sum_of_costs
    while not search.is_shortest and not deadline.has_passed:
        deadline.count(search.improve())
        trace.add(search.sum_of_costs)
    return search.path() if search.sum_of_costs < before else path


class NeighborhoodSearch:
    """Collision-free paths, some of which may be missing. Once none is missing, the sum of costs never increases."""

    def __init__(self, problem: Problem, rng: np.random.Generator) -> None:
        """Start without paths."""
        agents, cells = len(problem.goals), problem.leads_to.shape[1] - 1
        self._problem = sipp_problem(problem)
        self._shortest = sum_of_shortest(self._problem)
        self._neighborhood = allocate_neighborhood(agents, cells, int(rng.integers(1, 2**63)))
        self._allocate(self._shortest)

    def _allocate(self, num_visits: int) -> None:
        """Discard all paths, and allocate arrays for paths of about `num_visits` cells in total."""
        agents, cells = len(self._problem.goals), self._problem.leads_to.shape[1] - 1
        headings = num_headings(self._problem.to_go)
        # Paths that are being replaced take visits as long as the new ones are not accepted, and new paths may be
        # longer.
        capacity = 2 * num_visits + 64 * agents
        self._reservations = allocate_reservations(agents, cells, capacity)
        self._scratch = allocate_scratch(cells + 1 + capacity, headings, 64 + 4 * headings * cells)
        self._lns = allocate_lns(agents)

    @property
    def missing(self) -> int:
        """Number of agents without a path."""
        return int(self._lns.missing[0])

    @property
    def sum_of_costs(self) -> int:
        """Sum of the agents' costs, as in `Plan.costs`, if no path is missing."""
        return int(np.maximum(self._reservations.arrival, 1).sum())

    @property
    def is_shortest(self) -> bool:
        """Whether every path is a shortest path, if none is missing."""
        return self.sum_of_costs == self._shortest

    def set_paths(self, path: Path) -> None:
        """Set the paths of all agents."""
        self._allocate(int((path.cells[1:] != path.cells[:-1]).sum()) + path.cells.shape[1])
        read_path(self._reservations, path.cells, self._problem.disappear)
        self._lns.missing[0] = 0

    def set_arriving_paths(self, path: Path) -> None:
        """Set the paths that end at the agents' goals; the other agents are left without a path."""
        self.set_paths(path)
        for agent in np.flatnonzero(path.cells[-1] != self._problem.goals).tolist():
            discard(self._reservations, withdraw(self._reservations, agent))
            self._lns.missing[0] += 1

    def plan_missing(self, deadline: Deadline) -> None:
        """Plan the agents without paths, and those in their way, until there are none, or until `deadline`."""
        self._plan(np.flatnonzero(self._reservations.first == NONE), deadline)
        while self.missing and not deadline.has_passed:
            deadline.count(self.improve())

    def plan_all(self, order: Ints, deadline: Deadline) -> None:
        """Plan all agents from scratch in this order, until `deadline`; some may be left without a path."""
        self._allocate(self._shortest)
        self._plan(order, deadline)

    def _plan(self, order: Ints, deadline: Deadline) -> None:
        for batch in np.array_split(order, len(order) // BATCH_SIZE + 1):
            if not deadline.has_passed:
                deadline.count(self.improve(batch, work=0))

    def improve(self, order: Ints = NO_AGENTS, work: int = WORK) -> float:
        """Plan agents that have no paths yet, in this order, then improve the paths: see `plan_and_improve`.

        Return the work in seconds, as `Deadline.count` takes it.
        """
        expanded = int(self._scratch.count[1])
        plan_and_improve(self._problem, order, work, self._reservations, self._scratch, self._neighborhood, self._lns)
        return SECONDS_PER_STATE * (int(self._scratch.count[1]) - expanded)

    def path(self) -> Path:
        """Return the paths of all agents. None may be missing."""
        shape = (int(self._reservations.arrival.max(initial=0)) + 1, len(self._problem.goals))
        cells = np.empty(shape, np.int32)
        headings = np.empty(shape if num_headings(self._problem.to_go) == 4 else (0, 0), np.int8)
        write_path(self._reservations, self._problem.leads_to, self._problem.headings, cells, headings)
        return Path(cells, headings if headings.size else None)


def sipp_problem(problem: Problem) -> SippProblem:
    """Return the problem with the number of steps to go, which the search needs in addition to the weighted costs."""
    cells = np.arange(problem.leads_to.shape[1])
    weighted = problem.to_go.packed.shape[0] == 0
    return SippProblem(
        leads_to=np.where(np.isinf(problem.weight[:4]), cells, problem.leads_to).astype(np.int32),
        weight=problem.weight,
        to_go=problem.to_go,
        steps=_steps(problem) if weighted else problem.to_go.packed,
        table=problem.table,
        starts=problem.starts,
        headings=problem.headings,
        goals=problem.goals,
        weighted=weighted,
        disappear=problem.disappear,
    )


def _steps(problem: Problem) -> Ints:
    """Return the number of steps to go, packed, in tables like those of `problem.to_go`; others are unreachable."""
    headings = num_headings(problem.to_go)
    num_tables, num_cells, _ = problem.to_go.exact.shape
    steps = np.full((num_tables, num_cells), UNREACHABLE, np.uint32)
    queue = np.empty(num_cells * headings, np.int32)
    for table in np.unique(problem.table):
        goal = int(problem.goals[problem.table == table][0])
        count_steps(problem.leads_to, goal, headings, steps[table], queue)
    return steps
