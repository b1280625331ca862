"""The task of a solver, and its outcome."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

import numpy as np

from mapf_pz.editor.requests import Refusal
from mapf_pz.evaluation.solver import costs_text
from mapf_pz.guidance.library import EdgeWeights
from mapf_pz.instances import Delays, Instance
from mapf_pz.planners import Plan
from mapf_pz.planners.base import PlanFollower
from mapf_pz.planners.named import planner_class
from mapf_pz.simulator.kernels.cost_tables import default_bytes, table_bytes

OnStep: TypeAlias = "Callable[[int], object]"
"""Is called with the number of steps after each step."""


@dataclass(frozen=True)
class Task:
    """An instance, and how it is solved."""

    instance: Instance
    """The instance: one goal for each agent or, if `lifelong`, a sequence of goals for each."""
    solver: str
    """Name of a planner or policy, with options."""
    lifelong: bool
    """Whether an agent receives its next goal when it reaches one."""
    time_limit: float
    """Time limit in seconds."""
    max_steps: int
    """Maximum number of steps."""
    seed: int
    """Random seed."""
    edge_weights: EdgeWeights | None
    """The guidance graph. None: uniform for planners, and that of its training for a policy."""
    delays: Delays | None = None
    """Delays of agents. None: there are none."""

    @property
    def plans_paths(self) -> bool:
        """Whether the solver plans whole paths, before the first step, instead of single steps.

        With delays, which are not known beforehand, every solver acts in an episode.
        """
        planner = planner_class(self.solver)
        has_episode = self.lifelong or self.delays is not None
        return not has_episode and planner is not None and issubclass(planner, PlanFollower)

    @property
    def table_bytes(self) -> int:
        """Memory of the cost to go to the first goals of all agents, which all planners look up, in bytes."""
        scenario, cells = self.instance.scenario, self.instance.grid.free.size + 1
        first = scenario.goals.reshape(len(scenario), -1, 2)[:, 0]
        num_headings = 1 if self.instance.headings is None else 4
        return table_bytes(cells, num_headings, self.edge_weights is None) * len(np.unique(first, axis=0))


@dataclass(frozen=True)
class Outcome:
    """The end of a solver's work."""

    message: str
    """One-line summary."""
    num_steps: int
    """Number of steps."""
    unfinished: tuple[int, ...] = ()
    """The agents that are not at their goals; empty if lifelong."""
    is_over: bool = True
    """Whether no further step is possible."""
    seconds: float = 0.0
    """Runtime in seconds, without the compilation of kernels."""


class Solving(Protocol):
    """A solver that works on a task, and keeps its result."""

    def run(self) -> Outcome:
        """Solve the task; raises one of `USER_ERRORS` if that is impossible."""
        ...

    def resume(self, start: int, actions: Mapping[int, int], steps: int) -> Outcome:
        """Keep the first `start` steps, and add `steps`, in the first of which some agents take the given actions."""
        ...

    def episode(self) -> dict[str, Any]:
        """Return the result as the response to `episode`."""
        ...


def check_memory(tasks: Sequence[Task]) -> None:
    """Raise `Refusal` if solvers that run at the same time need more than half of the memory that can be used."""
    needed = sum(task.table_bytes for task in tasks)
    allowed = default_bytes(needed)
    if needed > allowed:
        takes = f"the cost to go to all goals takes {needed / 2**30:.1f} GiB"
        raise Refusal(400, f"memory: {takes}, expected at most {allowed / 2**30:.1f} GiB: use fewer agents or cells")


def plan_message(plan: Plan, instance: Instance, bound: int) -> str:
    """Return the costs of a plan or, if agents are not at their goals, their number."""
    away = int(plan.away(instance).sum())
    if away:
        return f"{away} of {plan.num_agents} agents are not at their goals after {plan.num_steps} steps"
    return costs_text(plan, bound)


def agents_away(plan: Plan, instance: Instance) -> tuple[int, ...]:
    """Return the agents that are not at their goals at the end of a plan."""
    return tuple(np.flatnonzero(plan.away(instance)).tolist())
