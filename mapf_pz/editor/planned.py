"""The work of planners of whole paths."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from mapf_pz.editor.task import Outcome, Task, agents_away, plan_message
from mapf_pz.evaluation.solver import no_plan_text
from mapf_pz.planners import Plan, planner_of, record_plan
from mapf_pz.planners.base import action_model_of, lower_bound
from mapf_pz.planners.plans.files import format_plan
from mapf_pz.render.recording import episode_data


class PlannedPaths:
    """The plan of a planner of whole paths."""

    def __init__(self, task: Task) -> None:
        """Create the planner of a task, and compile it; raises `ValueError` for an unknown name or option."""
        self._task = task
        self._solver = planner_of(task.solver, task.seed)
        self._solver.compile(action_model_of(task.instance))
        self._plan: Plan | None = None

    def run(self) -> Outcome:
        """Plan; raises `RuntimeError` if no plan is found within the limits."""
        task = self._task
        weights = task.edge_weights or "uniform"
        plan = self._solver.solve(task.instance, task.time_limit, task.max_steps, weights, partial=True)
        seconds = self._solver.trace.seconds
        if plan is None:
            limits = f"{task.time_limit:g} seconds and {task.max_steps} steps"
            raise RuntimeError(no_plan_text(task.solver, self._solver, task.instance, limits))
        self._plan = plan
        bound = plan.sum_of_costs if self._solver.optimal else lower_bound(task.instance)
        message = plan_message(plan, task.instance, bound)
        return Outcome(message, plan.num_steps, agents_away(plan, task.instance), seconds=seconds)

    def resume(self, start: int, actions: Mapping[int, int], steps: int) -> Outcome:
        """Raise `ValueError`, since single steps are not planned."""
        raise ValueError(f"{self._task.solver} plans whole paths: expected a policy, or a planner of single steps")

    def episode(self) -> dict[str, Any]:
        """Return the recording of the plan, and the plan's file; raises `RuntimeError` before `run`."""
        if self._plan is None:
            raise RuntimeError("there is no plan")
        task, plan = self._task, self._plan
        recording = replace(
            record_plan(task.instance, plan),
            name=task.solver,
            facts={"solver": task.solver, "seed": str(task.seed)},
            metrics={"SoC": plan.sum_of_costs, "makespan": plan.makespan},
        )
        text = format_plan(plan, "plan.json", task.instance)
        return {"episode": episode_data(recording), "goalsReached": None, "plan": text}
