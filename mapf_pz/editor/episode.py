"""The work of solvers: an episode of a policy or a planner of single steps, or the plan of a planner of whole paths."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from mapf_pz.editor.task import OnStep, Outcome, Task, agents_away, plan_message
from mapf_pz.environment.policy import actions_of, simulator_of
from mapf_pz.evaluation.episodes import compile_policy
from mapf_pz.evaluation.inspection import InspectedPolicy
from mapf_pz.evaluation.policies import policy_factory
from mapf_pz.evaluation.solver import instance_keywords, no_plan_text
from mapf_pz.instances import Instance, Scenario
from mapf_pz.planners import Plan, planner_of, record_plan
from mapf_pz.planners.base import Steps, action_model_of, lower_bound
from mapf_pz.planners.deadline import Deadline
from mapf_pz.planners.plans.files import format_plan
from mapf_pz.render.recording import episode_data
from mapf_pz.wrappers import RecordEpisode


class PolicyEpisode:
    """An episode of a policy, which can be resumed from any of its steps."""

    def __init__(self, task: Task, on_step: OnStep = lambda step: None) -> None:
        """Create the environment and the policy of a task.

        Raises `ValueError` for an unknown name or option, and if the policy needs another action model or another
        number of agents.
        """
        self._task = task
        self._on_step = on_step
        target = "restart" if task.lifelong else "nothing"
        keywords = instance_keywords(task.instance, task.max_steps, task.edge_weights, on_target=target)
        keywords["delays"] = task.delays
        env, policy = policy_factory(task.solver, task.seed)(keywords)
        compile_policy(env, policy, task.seed)
        self._env = RecordEpisode(env)
        self._policy = InspectedPolicy(policy, self._env)
        self._simulator = simulator_of(env)
        self._start()

    def run(self) -> Outcome:
        """Run the episode until all agents are at their goals, it ends, or the time limit passes."""
        start = time.perf_counter()
        deadline = Deadline(self._task.time_limit)
        self._start()
        while not (self._is_over or deadline.has_passed):
            self._step({})
        return self._outcome(time.perf_counter() - start)

    def resume(self, start: int, actions: Mapping[int, int], steps: int) -> Outcome:
        """Repeat the first `start` steps, and add up to `steps`.

        The policy also acts in the repeated steps, so that its state is the same; the recorded actions are taken.

        Args:
            start: number of steps that are kept.
            actions: actions in the next step by agent; the policy moves the others.
            steps: number of steps that are added; fewer if the episode ends.

        Raises:
            ValueError: the episode is shorter than `start`, or over after it.
        """
        begin = time.perf_counter()
        kept = self._actions[:start]
        self._start()
        for taken in kept:
            self._step(taken)
        if len(kept) < start or self._is_over:
            raise ValueError(f"expected a step before the end of the episode, got {start}")
        self._step({self._env.possible_agents[agent]: action for agent, action in actions.items()})
        for _ in range(steps - 1):
            if self._is_over:
                break
            self._step({})
        return self._outcome(time.perf_counter() - begin)

    def episode(self) -> dict[str, Any]:
        """Return the recording, the goals that were reached in each step, and the file of the steps as a plan."""
        task, plan = self._task, self._steps.plan()
        facts = {"solver": task.solver, "seed": str(task.seed)}
        if task.delays is not None:
            facts["delays"] = str(task.delays)
        inspection = self._policy.inspection if self._actions else None
        recording = replace(self._env.recording, name=task.solver, facts=facts, inspection=inspection)
        return {
            "episode": episode_data(recording),
            "goalsReached": np.diff(self._reached).tolist() if task.lifelong else None,
            "plan": format_plan(plan, "plan.json", self._visited() if task.lifelong else task.instance),
        }

    @property
    def _is_over(self) -> bool:
        agents = self._simulator.agents[0]
        return not self._env.agents or (not self._task.lifelong and bool(agents["at_goal"].all()))

    def _start(self) -> None:
        self._observations, self._infos = self._env.reset(seed=self._task.seed)
        self._policy.reset_states()
        self._steps = Steps(self._simulator)
        self._steps.add()
        self._actions: list[dict[str, int]] = []
        self._reached = [0]

    def _step(self, given: Mapping[str, int]) -> None:
        """Take a step, in which some agents take the given actions."""
        actions = actions_of(self._policy, self._observations, self._infos) | dict(given)
        self._observations, _, _, _, self._infos = self._env.step(actions)
        self._actions.append(actions)
        self._steps.add()
        self._reached.append(int(self._simulator.agents[0]["arrivals"].sum()))
        self._on_step(len(self._actions))

    def _outcome(self, seconds: float) -> Outcome:
        task, steps = self._task, len(self._actions)
        if task.lifelong:
            reached = self._reached[-1]
            throughput = f"throughput {reached / steps:.3f} goals per step" if steps else "no step"
            message = f"{task.instance.num_agents} agents reached {reached} goals in {steps} steps, {throughput}"
            return Outcome(message, steps, (), self._is_over, seconds)
        plan = self._steps.plan()
        away = agents_away(plan, task.instance)
        message = plan_message(plan, task.instance, lower_bound(task.instance))
        return Outcome(message, steps, away, self._is_over, seconds)

    def _visited(self) -> Instance:
        """Return the lifelong instance with the goals that the agents had, the last of which is not reached."""
        count = int(self._simulator.agents[0]["arrivals"].max()) + 1
        goals = self._simulator.coordinates(self._simulator.state.goals[0, :, :count])
        given = self._task.instance
        return Instance(given.grid, Scenario(given.scenario.starts, goals), given.headings)


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
