"""Runs of a policy over episodes, and the numbers that come of them."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any, Protocol, TypeAlias, cast

from pettingzoo.utils import BaseParallelWrapper

from mapf_pz.environment import AgentObservation, MapfEnv, parallel_env
from mapf_pz.evaluation.task import EvaluationTask
from mapf_pz.instance import Instance
from mapf_pz.simulator import Simulator
from mapf_pz.wrappers import FrameStack, NeighborObservations

AnyEnv: TypeAlias = "MapfEnv | BaseParallelWrapper[str, AgentObservation, Any]"
"""A `MapfEnv`, or a wrapper of one: it has the same attributes."""

WRAPPERS: dict[str, type[FrameStack | NeighborObservations]] = {
    "FrameStack": FrameStack,
    "NeighborObservations": NeighborObservations,
}
"""What policies may need around the environment, by name."""

Metrics = dict[str, float]


class Policy(Protocol):
    """What can be evaluated: the protocol of POGEMA's toolbox."""

    def act(self, observations: dict[str, Any]) -> dict[str, int]:
        """Return an action for each agent that observes."""
        ...

    def reset_states(self) -> None:
        """Forget the episode; called before each."""
        ...


PolicyFactory: TypeAlias = "Callable[[dict[str, Any]], tuple[AnyEnv, Policy]]"
"""Given keywords of `parallel_env`, makes the environment as the policy must see it, and the policy."""


def check_policy(policy: object) -> None:
    """Raise `TypeError` unless `policy` is an object with the methods of `Policy`."""
    if isinstance(policy, type):
        raise TypeError(f"policy {policy.__name__}: expected an object, such as {policy.__name__}(), got the class")
    for method in ("act", "reset_states"):
        if not callable(getattr(policy, method, None)):
            raise TypeError(f"policy {type(policy).__name__}: expected the methods act and reset_states, no {method}")


def make_env(policy: Policy, **keywords: Any) -> AnyEnv:
    """Return the environment of `parallel_env(**keywords)`, as the policy must see it.

    A policy may say so by two attributes: `env_kwargs`, keywords that those given here overrule, and `env_wrappers`,
    pairs of a name in `WRAPPERS` and its keywords, innermost first.
    """
    env: AnyEnv = parallel_env(**(getattr(policy, "env_kwargs", {}) | keywords))
    for name, arguments in getattr(policy, "env_wrappers", ()):
        env = WRAPPERS[name](env, **arguments)
    return env


def simulator_of(env: AnyEnv) -> Simulator:
    """Return the simulator of an environment, or of the one that it wraps."""
    return cast("MapfEnv", env.unwrapped).simulator


def play(env: AnyEnv, policy: Policy, seed: int, instance: Instance | None = None) -> Iterator[float]:
    """Play an episode; yield at its beginning (0.0), and after each step the seconds that the policy took to decide.

    Raises `TypeError` where `policy` is none.
    """
    check_policy(policy)
    observations, _ = env.reset(seed=seed, options=None if instance is None else {"instance": instance})
    policy.reset_states()
    yield 0.0
    while env.agents:
        began = time.perf_counter()
        actions = policy.act(observations)
        seconds = time.perf_counter() - began
        observations = env.step(actions)[0]
        yield seconds


def run_episodes(factory: PolicyFactory, task: EvaluationTask, episodes: Iterable[int]) -> Iterator[Metrics]:
    """Yield the metrics of some of a task's episodes.

    Besides those of `mapf_pz.metrics`: `runtime`, the seconds that the policy took to decide in an episode; `step_ms`
    and `agent_us`, the milliseconds a step and the microseconds an agent step of that; `collisions`, the share of agent
    steps in which a move was asked for that an obstacle or another agent prevented; `best_ratio`, the throughput over
    the best known, where there is a throughput.
    """
    scene: tuple[AnyEnv, Policy] | None = None
    size = ""
    for episode in episodes:
        keywords = task.env_keywords(episode)
        needed = keywords["source"].size if task.instances else ""
        if scene is None or size != needed:
            scene, size = factory(keywords), needed
            _compile(*scene, task.seed + episode)
        yield _metrics(*scene, task, episode)


def _compile(env: AnyEnv, policy: Policy, seed: int) -> None:
    """Let the policy decide once, so that what is compiled or loaded for it is not measured."""
    observations, _ = env.reset(seed=seed)
    policy.reset_states()
    env.step(policy.act(observations))


def _metrics(env: AnyEnv, policy: Policy, task: EvaluationTask, episode: int) -> Metrics:
    """Play an episode and return its metrics."""
    agents = simulator_of(env).state.agents[0]
    runtime, steps, blocked, acting = 0.0, 0, 0, 0
    for seconds in play(env, policy, task.seed + episode, task.instance(episode)):
        if env.step_count:
            runtime, steps = runtime + seconds, steps + 1
            blocked, acting = blocked + int(agents["blocked"].sum()), acting + int(agents["was_active"].sum())
    metrics = env.metrics() | {"runtime": runtime, "collisions": blocked / max(acting, 1)}
    metrics |= {"step_ms": 1e3 * runtime / max(steps, 1), "agent_us": 1e6 * runtime / max(acting, 1)}
    if task.best is not None and "avg_throughput" in metrics:
        metrics["best_ratio"] = metrics["avg_throughput"] / task.best
    return metrics
