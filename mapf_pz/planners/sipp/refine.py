"""Shortening the paths of a solution for as long as time allows."""

from __future__ import annotations

import time

import numpy as np

from mapf_pz.arrays import Floats, Ints
from mapf_pz.core.cost_to_go import cost_to_go
from mapf_pz.core.state import WAIT_WEIGHT
from mapf_pz.core.world import allocate
from mapf_pz.planners.problem import Path, Problem
from mapf_pz.planners.sipp.improve import allocate_lns, plan_and_improve
from mapf_pz.planners.sipp.neighborhood import allocate_neighborhood
from mapf_pz.planners.sipp.reservations import allocate_reservations, read_path, write_path
from mapf_pz.planners.sipp.search import SippProblem, allocate_scratch

WORK = 20_000
"""States that are expanded between two looks at the clock: some milliseconds."""
AT_ONCE = 16
"""Agents that are planned one after the other between two looks at the clock."""
NOBODY = np.zeros(0, np.int64)


def refine(search: NeighborhoodSearch, path: Path, deadline: float) -> Path:
    """Return a solution with a sum of costs as low as can be found in time, at worst `path` itself.

    Large neighbourhood search: see `mapf_pz.planners.sipp.improve`.

    Args:
        search: for the problem whose solution it is.
        path: a legal solution, that ends with all agents at their goals.
        deadline: when to stop, by `time.perf_counter`, which is looked at every few milliseconds.
    """
    if time.perf_counter() >= deadline:
        return path
    search.begin_with(path)
    before = search.sum_of_costs
    while not search.is_shortest and time.perf_counter() < deadline:
        search.improve()
    return search.path() if search.sum_of_costs < before else path


class NeighborhoodSearch:
    """Paths of all agents, some of which may be missing. They never collide; once all are there, they get no longer."""

    def __init__(self, problem: Problem, rng: np.random.Generator) -> None:
        """Begin without paths."""
        agents, cells = len(problem.goals), problem.to_go.shape[1] - 1
        self._task = task_of(problem)
        shortest = self._task.steps[problem.table, problem.starts, problem.headings % problem.to_go.shape[2]]
        self._shortest = int(shortest.sum())
        self._neighborhood = allocate_neighborhood(agents, cells, int(rng.integers(1, 2**63)))
        self._make_room(self._shortest)

    def _make_room(self, num_visits: int) -> None:
        """Forget all paths; about `num_visits` cells are expected on all of them together."""
        agents, cells, headings = len(self._task.goals), self._task.steps.shape[1] - 1, self._task.steps.shape[2]
        room = 2 * num_visits + 64 * agents
        self._reservations = allocate_reservations(agents, cells, room)
        self._scratch = allocate_scratch(cells + 1 + room, headings, 64 + 4 * headings * cells)
        self._lns = allocate_lns(agents)

    @property
    def missing(self) -> int:
        """How many agents have no path yet."""
        return int(self._lns.missing[0])

    @property
    def sum_of_costs(self) -> int:
        """The sum of the steps after which the agents rest at their goals, if no path is missing."""
        return int(self._reservations.arrival.sum())

    @property
    def is_shortest(self) -> bool:
        """Whether no path can be shorter, if none is missing."""
        return self.sum_of_costs == self._shortest

    def begin_with(self, path: Path) -> None:
        """Take over the paths of all agents."""
        self._make_room(int((path.cells[1:] != path.cells[:-1]).sum()) + path.cells.shape[1])
        read_path(self._reservations, path.cells)
        self._lns.missing[0] = 0

    def begin_anew(self, order: Ints, deadline: float) -> None:
        """Plan all agents in this order, until `deadline`; some may be left without a path."""
        self._make_room(self._shortest)
        for few in np.array_split(order, len(order) // AT_ONCE + 1):
            if time.perf_counter() < deadline:
                self.improve(few, work=0)

    def improve(self, order: Ints = NOBODY, work: int = WORK) -> None:
        """Plan agents that have no paths yet, in this order, then improve the paths: see `plan_and_improve`."""
        plan_and_improve(self._task, order, work, self._reservations, self._scratch, self._neighborhood, self._lns)

    def path(self) -> Path:
        """Return the paths of all agents, if none is missing."""
        shape = (int(self._reservations.arrival.max(initial=0)) + 1, len(self._task.goals))
        cells = np.empty(shape, np.int32)
        headings = np.empty(shape if self._task.steps.shape[2] == 4 else (0, 0), np.int8)
        write_path(self._reservations, self._task.leads_to, self._task.headings, cells, headings)
        return Path(cells, headings if headings.size else None)


def task_of(problem: Problem) -> SippProblem:
    """Return the problem as the search reads it, which needs the fewest steps to go also where there are weights."""
    leads_to, weight = problem.leads_to, problem.weight
    cells = np.arange(leads_to.shape[1])
    open_moves = leads_to != cells
    free = open_moves.any(axis=0)
    weighted = bool((weight[:4][open_moves] != 1).any() or (weight[WAIT_WEIGHT][free] != 1).any())
    return SippProblem(
        leads_to=np.where(np.isinf(weight[:4]), cells, leads_to).astype(np.int32),
        weight=weight,
        to_go=problem.to_go,
        steps=_steps(problem) if weighted else problem.to_go,
        table=problem.table,
        starts=problem.starts,
        headings=problem.headings,
        goals=problem.goals,
        weighted=weighted,
    )


def _steps(problem: Problem) -> Floats:
    """Return the fewest steps to go, in tables like `problem.to_go`; those that are not in use stay empty."""
    steps = np.full_like(problem.to_go, np.inf)
    unweighted = allocate(1, (1, 1))._replace(leads_to=problem.leads_to[None])
    scratch = np.empty((2, steps[0].size), np.int32)
    for table in np.unique(problem.table):
        goal = problem.goals[problem.table == table][0]
        cost_to_go(unweighted, 0, goal, 1.0, steps[table], scratch)
    return steps
