"""The execution of plans under delays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mapf_pz._internal.arrays import Bools, Ints
from mapf_pz.instances.delays import Delays
from mapf_pz.planners.plans.dependencies import DependencyGraph
from mapf_pz.planners.plans.execution import Execution
from mapf_pz.planners.plans.plan import Plan
from mapf_pz.planners.plans.switching import SwitchableExecution
from mapf_pz.simulator.kernels.delay import delay_rules, delayed_agents
from mapf_pz.simulator.metrics import costs_alone

MAX_STEPS = 50_000
"""Number of steps after which an execution is given up."""


@dataclass(frozen=True, eq=False)
class DelayedExecution:
    """A plan that was executed by its dependency graph while agents were delayed."""

    plan: Plan
    """The steps that were taken."""
    costs_alone: Ints
    """(N,) int64: the costs with these delays of agents that never wait for others: the step after which each of them
    has executed all actions, at least 1."""
    delayed: Bools
    """(T, N) bool: in which of the steps which agents were delayed."""
    waits_for: Ints
    """(T, N) int64: the agent that each agent waited for in each step; -1 if it acted, was delayed itself, or had no
    action left."""


def execute_delayed(graph: DependencyGraph, delays: Delays, seed: int, switch: bool = False) -> DelayedExecution:
    """Execute a plan by its dependency graph under delays, which the seed determines.

    Args:
        graph: the graph of the plan.
        delays: the delays.
        seed: the random seed of the delays.
        switch: whether agents may go before others that are late: see `SwitchableExecution`.

    Raises `ValueError` if it takes more than `MAX_STEPS` steps, such as with agents that are always delayed.
    """
    key = int(np.random.default_rng(seed).integers(2**64, dtype=np.uint64))
    num_steps = 2 * int(graph.steps.max(initial=0)) + 1
    execution = SwitchableExecution(graph) if switch else Execution(graph)
    done, waits_for = [], []
    while num_steps < 2 * MAX_STEPS:
        delayed = delayed_agents(delay_rules(delays), key, num_steps, graph.num_agents)
        for late in execution.steps(delayed[len(done) :]):
            done.append(execution.done)
            waits_for.append(execution.waiting_for(late))
        if execution.is_finished:
            plan, alone = graph.plan_of(np.stack([*done, execution.done])), costs_alone(graph.num_actions, delayed)
            waited = np.array(waits_for, np.int64).reshape(-1, graph.num_agents)
            return DelayedExecution(plan, alone, delayed[: len(waited)], waited)
        num_steps *= 2  # the delays of the first steps stay the same
    raise ValueError(f"delays={delays}: the execution has not ended after {num_steps // 2} steps")
