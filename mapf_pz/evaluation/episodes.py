"""Run policies in episodes, and measure their metrics."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import groupby

from mapf_pz.environment.mapf_env import MapfEnv
from mapf_pz.environment.policy import (
    AnyEnv,
    BatchPolicy,
    Policy,
    PolicyFactory,
    actions_of,
    check_policy,
    simulator_of,
)
from mapf_pz.evaluation.batch import EpisodeBatch, batch_of
from mapf_pz.evaluation.external.planned_policy import PlannedPolicy
from mapf_pz.evaluation.measures import Measures, Metrics
from mapf_pz.evaluation.task import EvaluationTask
from mapf_pz.instances.instance import Instance


@dataclass(frozen=True)
class Rollout:
    """An episode that a policy has run."""

    metrics: Metrics
    """The metrics of the episode: see `mapf_pz.simulator.metrics`."""
    num_steps: int
    """Number of steps."""
    runtime: float
    """Runtime of the policy in CPU seconds of this process."""


def rollout(
    env: AnyEnv,
    policy: Policy,
    seed: int | None = None,
    instance: Instance | None = None,
    on_step: Callable[[], object] = lambda: None,
    until: Callable[[], bool] = lambda: False,
) -> Rollout:
    """Run an episode.

    Args:
        env: The environment.
        policy: The policy of all agents.
        seed: Random seed of the episode, as in `reset`.
        instance: Instance of the episode; None: the environment samples it.
        on_step: Is called after the reset and after each step.
        until: Is called before each step; the episode is left if it returns True.

    Raises:
        TypeError: `policy` is not a policy.
    """
    check_policy(policy)
    observations, infos = env.reset(seed=seed, options=None if instance is None else {"instance": instance})
    policy.reset_states()
    on_step()
    runtime = 0.0
    while env.agents and not until():
        start = time.process_time()
        actions = actions_of(policy, observations, infos)
        runtime += time.process_time() - start
        observations, _, _, _, infos = env.step(actions)
        on_step()
    return Rollout(env.metrics(), env.step_count, runtime)


def run_episodes(
    factory: PolicyFactory,
    task: EvaluationTask,
    episodes: Iterable[int],
    on_note: Callable[[int, str], object] = lambda episode, note: None,
) -> Iterator[Metrics]:
    """Yield the metrics of some of a task's episodes.

    In addition to those of `mapf_pz.simulator.metrics`, they are: `runtime`, the CPU seconds of the policy in an
    episode, of all threads of this process (of a program: elapsed seconds); `step_ms` and `agent_us`, this runtime per
    step in milliseconds and per agent step in microseconds; `collisions`, the fraction of agent steps with a move that
    an obstacle or another agent blocked; `best_ratio`, the throughput divided by the best known throughput, or the sum
    of costs of a solved episode divided by the best known.

    A policy with `in_batch` acts in several episodes at the same time, and its runtime in a step is divided equally
    among them. The other metrics do not depend on which episodes these are.

    `on_note` is called with the number and the note of each episode that gets an `Episode.note`.
    """
    for _, group in groupby(episodes, partial(_map_size, task)):
        numbers = list(group)
        env, policy = factory(task.env_keywords(numbers[0]))
        batch = _batch(env, policy, task, numbers)
        if batch is not None:
            of_all = batch.run(numbers)
            yield from (of_all[number] for number in numbers)
        else:
            if not isinstance(policy, PlannedPolicy):  # which runs another program
                compile_policy(env, policy, task.seed + numbers[0])
            for number in numbers:
                metrics = _metrics(env, policy, task, number)
                if isinstance(policy, PlannedPolicy) and policy.note:
                    on_note(number, policy.note)
                yield metrics


def _map_size(task: EvaluationTask, episode: int) -> tuple[int, int] | None:
    """Return the size of an episode's map; None if the environment generates the episodes, all of the same size."""
    instance = task.instance(episode)
    return None if instance is None else instance.grid.shape


def _batch(env: AnyEnv, policy: Policy | BatchPolicy, task: EvaluationTask, episodes: list[int]) -> EpisodeBatch | None:
    """Return a batch for the episodes; None if the policy or the environment, such as a wrapper, is for single ones."""
    if type(env) is not MapfEnv or not isinstance(policy, BatchPolicy):
        return None
    simulator = batch_of(env.simulator, task, episodes)
    in_batch = policy.in_batch(simulator)
    return None if in_batch is None else EpisodeBatch(simulator, in_batch, task)


def compile_policy(env: AnyEnv, policy: Policy, seed: int) -> None:
    """Call the policy once, so that compilation and loading are not measured."""
    observations, infos = env.reset(seed=seed)
    policy.reset_states()
    env.step(actions_of(policy, observations, infos))


def _metrics(env: AnyEnv, policy: Policy, task: EvaluationTask, episode: int) -> Metrics:
    """Run an episode and return its metrics."""
    agents = simulator_of(env).agents[0]
    measures = Measures()

    def measure() -> None:
        if env.step_count:
            measures.add_step(int(agents["was_active"].sum()), int(agents["blocked"].sum()))

    if isinstance(policy, PlannedPolicy):
        policy.instance_name = task.plan_name(episode)
    result = rollout(env, policy, task.seed + episode, task.instance(episode), measure)
    measures.runtime = policy.seconds if isinstance(policy, PlannedPolicy) else result.runtime
    return measures.added_to(result.metrics, task.best_result(episode, simulator_of(env).config))
