"""Solvers of instances by name: planners, and policies, whose steps in an episode are the plan."""

from __future__ import annotations

import time
from typing import Any, ClassVar

from mapf_pz.environment.policy import AnyEnv, Policy, simulator_of
from mapf_pz.evaluation.episodes import compile_policy, rollout
from mapf_pz.evaluation.policies import policy_factory
from mapf_pz.guidance.library import EdgeWeights
from mapf_pz.instances.instance import Instance
from mapf_pz.instances.sources import InstanceList
from mapf_pz.planners import Plan, Planner, Trace, base, planner_of
from mapf_pz.planners.base import Steps, action_model_of
from mapf_pz.planners.deadline import Deadline
from mapf_pz.planners.named import planner_class
from mapf_pz.planners.problem import obstruction, problem_of
from mapf_pz.simulator.config import OnTarget


def solver_of(name: str, seed: int = 0, trust_remote_code: bool = False) -> Planner | PolicySolver:
    """Return a planner or a policy by its name, as in `policy_factory`, that solves instances.

    Args:
        name: a planner or a policy, with options, such as `lacam:anytime=False` or `oneshot+pibt`.
        seed: random seed.
        trust_remote_code: whether the configuration of a trained policy may name code outside this package.

    Raises:
        ValueError: the name or an option of it is unknown, or the value of an option is invalid.
    """
    if planner_class(name) is not None:
        return planner_of(name, seed)
    return PolicySolver(name, seed, trust_remote_code)


def instance_keywords(
    instance: Instance,
    max_steps: int,
    edge_weights: EdgeWeights | None,
    distance_bytes: int | None = None,
    on_target: OnTarget = "nothing",
) -> dict[str, Any]:
    """Return the keywords of an environment whose episodes are all of this instance; a policy sets the others.

    If `edge_weights` is None, the policy also sets the guidance graph.
    """
    weights: dict[str, Any] = {} if edge_weights is None else {"edge_weights": edge_weights}
    return {
        "source": InstanceList([instance]),
        "action_model": action_model_of(instance),
        "on_target": on_target,
        "max_steps": max_steps,
        "distance_bytes": distance_bytes,
    } | weights


def costs_text(plan: Plan, bound: int) -> str:
    """Return the costs of a plan in one line, with their ratio to a lower bound of the sum of costs."""
    return (
        f"{plan.num_agents} agents, sum of costs {plan.sum_of_costs}, makespan {plan.makespan}, "
        f"{plan.sum_of_costs / bound:.3f} times the lower bound {bound}"
    )


def no_plan_text(name: str, solver: Planner | PolicySolver, instance: Instance, limits: str) -> str:
    """Return in one line that `solver` has found no plan, and whether there is none.

    Args:
        name: the solver's name.
        solver: the solver, which has just tried.
        instance: the instance.
        limits: the limits, such as `3 seconds and 1000 steps`.
    """
    if solver.unsolvable:
        return f"{name}: the instance has no plan: {solver.unsolvable}"
    return f"{name} found no plan for {instance.num_agents} agents within {limits}"


class PolicySolver:
    """Solves instances with a policy as `Planner.solve` does. It stops as soon as all agents are at their goals."""

    optimal: ClassVar[bool] = False
    """Whether plans have the lowest possible sum of costs."""

    def __init__(self, name: str, seed: int = 0, trust_remote_code: bool = False) -> None:
        """Create the solver; takes the arguments of `solver_of` and raises the same errors."""
        self._seed = seed
        self._factory = policy_factory(name, seed, trust_remote_code=trust_remote_code)
        self.trace = Trace(time.perf_counter)
        """The solution of the latest call of `solve`."""
        self.unsolvable: str | None = None
        """Why the instance of the latest call of `solve` has no plan at all; None: not proved."""

    def solve(
        self,
        instance: Instance,
        time_limit: float = 10.0,
        max_steps: int = 1000,
        edge_weights: EdgeWeights | None = None,
        distance_bytes: int | None = None,
        partial: bool = False,
    ) -> Plan | None:
        """Return the policy's steps if they bring all agents to their goals, otherwise None.

        Args:
            instance: an instance with one goal for each agent; with headings for rotating agents, without headings for
                cardinal agents.
            time_limit: time limit in seconds, which excludes the compilation of kernels.
            max_steps: maximum number of steps.
            edge_weights: the guidance graph, as in `EnvConfig`. None: that of the policy's training.
            distance_bytes: maximum memory for cost-to-go tables, as in `EnvConfig`.
            partial: whether to return the steps up to the limits if some agents are not at their goals then.

        Raises:
            ValueError: the policy needs another action model or another number of agents.
        """
        env, policy = self._factory(instance_keywords(instance, max_steps, edge_weights, distance_bytes))
        compile_policy(env, policy, self._seed)
        self.trace = Trace(time.perf_counter)
        plan = _run_episode(env, policy, self._seed, Deadline(time_limit, time.perf_counter))
        self.unsolvable = None
        if plan.away(instance).any():
            weights = simulator_of(env).config.edge_weights
            simulator = base.simulator_of(instance, max_steps, weights, self._seed, distance_bytes)
            self.unsolvable = obstruction(problem_of(simulator))
            return plan if partial else None
        self.trace.add(plan.sum_of_costs)
        return plan


def _run_episode(env: AnyEnv, policy: Policy, seed: int, deadline: Deadline) -> Plan:
    """Run an episode until it ends or the deadline passes, and return its steps."""
    simulator = simulator_of(env)
    steps = Steps(simulator)
    agents = simulator.agents[0]
    rollout(env, policy, seed, on_step=steps.add, until=lambda: agents["at_goal"].all() or deadline.has_passed)
    return steps.plan()
