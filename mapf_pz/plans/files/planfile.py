"""What a plan file holds besides the plan, and what is said about a plan when it is written."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from mapf_pz.arrays import Ints, frozen
from mapf_pz.errors import FormatError
from mapf_pz.instance import Scenario
from mapf_pz.plans.plan import Plan, reached

MAX_PLACES = 50_000_000
"""Plans of more steps times agents are refused."""


_NO_ERRANDS = frozen([], np.int32)


@dataclass(frozen=True, eq=False)
class Schedule:
    """Which tasks each agent was given, and when."""

    assigned: tuple[tuple[tuple[int, int], ...], ...]
    """For each agent (step, task), in order: from the end of that step on the task counts; a task below 0 is none."""
    tasks: Mapping[int, Ints]
    """The errands (L, 2) of each task, [row, col], as the file tells them."""

    def finished(self, plan: Plan, task: Callable[[int], Ints] | None = None) -> int:
        """Return how many tasks a plan finishes, all errands of each in order.

        Args:
            plan: Of as many agents as there are in the schedule.
            task: Returns the errands of a task; None: the file's.

        Raises:
            ValueError: The schedule is of other agents, or an assigned task is not among the file's.
        """
        if len(self.assigned) != plan.num_agents:
            raise ValueError(f"schedule: expected {plan.num_agents} agents, got {len(self.assigned)}")
        left: dict[int, Ints] = {}
        for agent, given in enumerate(self.assigned):
            ends = [step for step, _ in given[1:]] + [plan.num_steps + 1]
            for (step, number), end in zip(given, ends, strict=False):
                if number >= 0:
                    errands = left[number] if number in left else self._errands(number, task)
                    # The first row of a path is where it starts, which reaches nothing.
                    path = plan.positions[max(step - 1, 0) : end, agent]
                    left[number] = errands[len(reached(path, errands)) :]
        return sum(len(errands) == 0 for errands in left.values())

    def only_goals(self) -> Ints | None:
        """Return the goals (N, 2) of agents that were given a single task of one errand each, else None."""
        tasks = [self.tasks.get(given[0][1], _NO_ERRANDS) for given in self.assigned if len(given) == 1]
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
    """A plan, and what its file says about it. None of that is checked."""

    plan: Plan
    """The plan."""
    goals: Ints | None = None
    """(N, 2), [row, col]: each agent's one goal, where the file tells them."""
    schedule: Schedule | None = None
    """The tasks that agents were given, where the file tells them."""
    claims: Mapping[str, int] = field(default_factory=dict[str, int])
    """What the file says of `sum of costs`, `makespan` and `tasks finished`."""


@dataclass(frozen=True)
class Selection:
    """What a plan is for: needed where a file holds several, or does not tell the starts."""

    scenario: Scenario | None = None
    """Starts of the agents, of which the first are taken."""
    num_agents: int | None = None
    """How many agents the plan is for; None: any."""
    name: str = ""
    """The scenario's name, such as `random-32-32-20-even-1`; empty: any."""


@dataclass(frozen=True)
class About:
    """What is written into a file, where its format has a place for it."""

    scenario: str = ""
    """The scenario's name, such as `random-32-32-20-even-1`."""
    solver: str = "mapf-pz"
    """Who made the plan."""
    seconds: float = 0.0
    """How long that took."""


def check_size(num_steps: int, num_agents: int, origin: object, line: int = 0) -> None:
    """Raise `FormatError` for a plan with more than `MAX_PLACES` steps times agents."""
    if num_steps * num_agents > MAX_PLACES:
        size = f"{num_steps} steps of {num_agents} agents"
        raise FormatError(origin, f"expected at most {MAX_PLACES} steps times agents, got {size}", line)


def one_goal_each(goals: Ints, form: str) -> Ints:
    """Return goals (N, 2); raises `ValueError` where agents have several, of which a file of that form cannot tell."""
    if goals.ndim != 2:
        raise ValueError(f"a {form} file holds one goal for each agent: this instance has several")
    return np.asarray(goals)
