"""The contents of a plan file: the plan, its schedule of tasks, and its metadata."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from mapf_pz._internal.arrays import Ints, frozen
from mapf_pz.errors import FormatError
from mapf_pz.instances.instance import Scenario
from mapf_pz.planners.plans.plan import Plan, reached

MAX_POSITIONS = 50_000_000
"""Maximum number of steps times agents of a plan file."""


_NO_ERRANDS = frozen([], np.int32)


class Visit(NamedTuple):
    """An agent visits an errand of its task."""

    step: int
    """The step, from 1."""
    agent: int
    """The agent."""
    task: int
    """The task's number."""
    num_visited: int
    """How many errands of the task have been visited, from 1."""
    is_last: bool
    """Whether the task is finished."""


@dataclass(frozen=True, eq=False)
class Schedule:
    """The tasks that were assigned to each agent, and when."""

    assigned: tuple[tuple[tuple[int, int], ...], ...]
    """For each agent (step, task), in order: the task is assigned from the end of that step on; below 0: no task."""
    tasks: Mapping[int, Ints]
    """The errands (L, 2), [row, col], of each task, as given in the file."""
    revealed: Mapping[int, int] = field(default_factory=dict[int, int])
    """The step after which each task was revealed, if it is known."""

    def finished(self, plan: Plan, task: Callable[[int], Ints] | None = None) -> int:
        """Return how many tasks a plan finishes: see `visits`, which has the same arguments."""
        return sum(visit.is_last for visit in self.visits(plan, task))

    def visits(self, plan: Plan, task: Callable[[int], Ints] | None = None) -> list[Visit]:
        """Return the visits of errands in a plan by step, where agents visit all errands of a task in order.

        Args:
            plan: a plan with the agents of the schedule.
            task: a function that returns the errands of a task; None: those of the file.

        Raises:
            ValueError: the schedule has another number of agents, or an assigned task is missing in the file.
        """
        if len(self.assigned) != plan.num_agents:
            raise ValueError(f"schedule: expected {plan.num_agents} agents, got {len(self.assigned)}")
        visited: dict[int, int] = {}
        visits: list[Visit] = []
        for agent, assigned in enumerate(self.assigned):
            ends = [step for step, _ in assigned[1:]] + [plan.num_steps + 1]
            for (step, number), end in zip(assigned, ends, strict=False):
                if number >= 0:
                    errands, count = self._errands(number, task), visited.get(number, 0)
                    # The first row of a path is its start, which does not count as an arrival.
                    first = max(step - 1, 0)
                    for after in reached(plan.positions[first:end, agent], errands[count:]):
                        count += 1
                        visits.append(Visit(first + after, agent, number, count, count == len(errands)))
                    visited[number] = count
        return sorted(visits)

    def only_goals(self) -> Ints | None:
        """Return the goals (N, 2) if every agent has exactly one task with one errand, else None."""
        tasks = [self.tasks.get(assigned[0][1], _NO_ERRANDS) for assigned in self.assigned if len(assigned) == 1]
        if len(tasks) < len(self.assigned) or any(len(errands) != 1 for errands in tasks):
            return None
        return np.concatenate(tasks)

    def _errands(self, number: int, task: Callable[[int], Ints] | None) -> Ints:
        if task is not None:
            return task(number)
        if number not in self.tasks:
            raise ValueError(f"schedule: task {number} is not among the file's tasks")
        return self.tasks[number]


@dataclass(frozen=True, eq=False)
class PlanFile:
    """A plan, and what its file claims about it, which is not checked."""

    plan: Plan
    """The plan."""
    goals: Ints | None = None
    """(N, 2), [row, col]: each agent's goal, if the file contains them."""
    schedule: Schedule | None = None
    """The assigned tasks, if the file contains them."""
    claims: Mapping[str, int] = field(default_factory=dict[str, int])
    """The file's values of `sum of costs`, `makespan` and `tasks finished`."""


@dataclass(frozen=True)
class Selection:
    """Selects a plan. It is needed for files that hold several plans, or that lack the starts."""

    scenario: Scenario | None = None
    """A scenario with the starts of the agents; the plan uses the first ones."""
    num_agents: int | None = None
    """Number of agents of the plan; None: any."""
    name: str = ""
    """The scenario's name, such as `random-32-32-20-even-1`; empty: any."""


@dataclass(frozen=True)
class PlanMetadata:
    """Metadata that is written to a plan file if its format has fields for it."""

    scenario_name: str = ""
    """The scenario's name, such as `random-32-32-20-even-1`."""
    solver: str = "mapf-pz"
    """Name of the solver."""
    seconds: float = 0.0
    """Runtime of the solver in seconds."""
    lower_bound: int | None = None
    """A lower bound on the sum of costs."""
    schedule: Schedule | None = None
    """The tasks that were assigned to each agent during a lifelong episode."""


def check_size(num_steps: int, num_agents: int, origin: object, line: int = 0) -> None:
    """Raise `FormatError` if a plan has more than `MAX_POSITIONS` steps times agents."""
    if num_steps * num_agents > MAX_POSITIONS:
        size = f"{num_steps} steps of {num_agents} agents"
        raise FormatError(origin, f"expected at most {MAX_POSITIONS} steps times agents, got {size}", line)


def one_goal_each(goals: Ints, format_name: str) -> Ints:
    """Return the goals (N, 2); raises `ValueError` if agents have several goals, which the format cannot hold."""
    if goals.ndim != 2:
        raise ValueError(f"a {format_name} file holds one goal for each agent, but this instance has several")
    return np.asarray(goals)
