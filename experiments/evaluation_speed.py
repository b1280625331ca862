"""Measure how fast trained policies are evaluated: `PYTHONPATH=. python experiments/evaluation_speed.py`.

Prints the CPU time per agent step of the suite `standard` with one episode at a time and with batches of episodes, in
alternating runs, and the time of the network alone in batches of 256 agents: medians of several runs.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from statistics import median
from typing import Any

import tyro

from mapf_pz._internal.parallel import use_one_thread
from mapf_pz.evaluation import EvaluationTask, Policy, load_suite, policy_factory
from mapf_pz.evaluation.episodes import AnyEnv, PolicyFactory, run_episodes

NUM_ROWS = 256


class OneByOne:
    """A policy without `in_batch`, so that it acts in one episode at a time."""

    def __init__(self, policy: Policy) -> None:
        """Keep the methods of a policy."""
        self.act, self.reset_states = policy.act, policy.reset_states
        self.needs_infos = getattr(policy, "needs_infos", False)


def one_by_one(factory: PolicyFactory) -> PolicyFactory:
    """Return a factory of the same policies, which act in one episode at a time."""

    def make(keywords: dict[str, Any]) -> tuple[AnyEnv, Policy]:
        env, policy = factory(keywords)
        return env, OneByOne(policy)

    return make


def cpu_seconds(run: Callable[[], object]) -> float:
    """Return the CPU time of a call."""
    start = time.process_time()
    run()
    return time.process_time() - start


def network_microseconds(name: str) -> float:
    """Return the time of a policy's network per agent, in microseconds."""
    import torch

    from mapf_pz.rl import load_policy
    from mapf_pz.rl.networks.observation_shape import ObservationShape

    policy = load_policy(name)
    shape = ObservationShape.of_task(policy.config.task)
    inputs = torch.rand(NUM_ROWS, *shape.image), torch.rand(NUM_ROWS, shape.features)
    with torch.no_grad():
        times = [cpu_seconds(lambda: policy.network(*inputs)) for _ in range(50)]
    return 1e6 * median(times) / NUM_ROWS


def measured(factory: PolicyFactory, task: EvaluationTask) -> tuple[float, float]:
    """Return the CPU time of all episodes of a task, and the number of their agent steps."""
    episodes: list[dict[str, float]] = []
    seconds = cpu_seconds(lambda: episodes.extend(run_episodes(factory, task, range(task.episodes))))
    return seconds, sum(1e6 * episode["runtime"] / episode["agent_us"] for episode in episodes)


def evaluation_speed(
    policies: tuple[str, ...] = ("mappo", "mappo+pibt", "oneshot", "lifelong"), share: float = 0.25, runs: int = 3
) -> None:
    """Evaluate policies on the suite `standard`.

    Args:
        policies: names of trained policies.
        share: fraction of the suite's episodes.
        runs: number of runs.
    """
    use_one_thread()
    for name in policies:
        print(f"{name}: network {network_microseconds(name.partition('+')[0]):.1f} us per agent")
        factory = policy_factory(name)
        for task in load_suite("standard"):
            task = task.with_(episodes=max(1, round(share * task.episodes)))
            makers = {"one": one_by_one(factory), "batch": factory}
            for maker in makers.values():
                measured(maker, task.with_(episodes=2))
            found = [{kind: measured(maker, task) for kind, maker in makers.items()} for _ in range(runs)]
            one, batch = (median(1e6 * run[kind][0] / run[kind][1] for run in found) for kind in makers)
            ratio = median(run["one"][0] / run["batch"][0] for run in found)
            print(f"  {task.label}: {one:.1f} us per agent step one by one, {batch:.1f} in batches, ratio {ratio:.1f}")


if __name__ == "__main__":
    tyro.cli(evaluation_speed)
