"""How fast trained policies are evaluated."""

from __future__ import annotations

from typing import Any

from experiments.speed.runs import Run, measure, timed
from mapf_pz._internal.parallel import use_one_thread
from mapf_pz.environment.policy import AnyEnv, PolicyFactory
from mapf_pz.evaluation import EvaluationTask, Policy, load_suite, policy_factory
from mapf_pz.evaluation.episodes import run_episodes

NUM_ROWS, NETWORK_RUNS = 256, 50


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


def network_run(name: str) -> Run:
    """Call a policy's network once for `NUM_ROWS` agents."""
    import torch

    from mapf_pz.rl import load_policy
    from mapf_pz.rl.networks.observation_shape import ObservationShape

    policy = load_policy(name)
    shape = ObservationShape.of_task(policy.config.task)
    inputs = torch.rand(NUM_ROWS, *shape.image), torch.rand(NUM_ROWS, shape.features)

    def play() -> int:
        with torch.no_grad():
            policy.network(*inputs)
        return NUM_ROWS

    return timed(play)


def episodes_run(factory: PolicyFactory, task: EvaluationTask) -> Run:
    """Run all episodes of a task."""

    def play() -> int:
        episodes = run_episodes(factory, task, range(task.episodes))
        return round(sum(1e6 * episode["runtime"] / episode["agent_us"] for episode in episodes))

    return timed(play)


def main(
    policies: tuple[str, ...] = ("mappo", "mappo+pibt", "oneshot", "lifelong"), share: float = 0.25, runs: int = 3
) -> None:
    """Evaluate policies on the suite `standard`.

    Prints the CPU time per agent step with one episode at a time and with batches of episodes, and the time of the
    network alone in batches of 256 agents: medians of several runs.

    Args:
        policies: names of trained policies.
        share: fraction of the suite's episodes.
        runs: number of runs.
    """
    use_one_thread()
    for name in policies:
        network = measure({"network": network_run(name.partition("+")[0])}, min_runs=NETWORK_RUNS)["network"]
        print(f"{name}: network {1e6 / network.cpu_rate:.1f} us per agent")
        factory = policy_factory(name)
        for task in load_suite("standard"):
            task = task.with_(episodes=max(1, round(share * task.episodes)))
            makers = {"one": one_by_one(factory), "batch": factory}
            found = measure({kind: episodes_run(maker, task) for kind, maker in makers.items()}, min_runs=runs)
            one, batch = (1e6 / found[kind].cpu_rate for kind in makers)
            ratio = one / batch
            print(f"  {task.label}: {one:.1f} us per agent step one by one, {batch:.1f} in batches, ratio {ratio:.1f}")
