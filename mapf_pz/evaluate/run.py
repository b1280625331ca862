"""Runs of a policy over episodes, and the numbers that come of them."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeAlias

from pettingzoo.utils import BaseParallelWrapper

from mapf_pz.environment import AgentObservation, MapfEnv, parallel_env
from mapf_pz.wrappers import History, Sharing

AnyEnv: TypeAlias = "MapfEnv | BaseParallelWrapper[str, AgentObservation, Any]"
"""A `MapfEnv`, or a wrapper of one: it has the same attributes."""

WRAPPERS: dict[str, type[History | Sharing]] = {"History": History, "Sharing": Sharing}
"""What policies may need around the environment, by name."""


class Policy(Protocol):
    """What can be evaluated: the protocol of POGEMA's toolbox."""

    def act(self, observations: dict[str, Any]) -> dict[str, int]:
        """Return an action for each agent that observes."""
        ...

    def reset_states(self) -> None:
        """Forget the episode; called before each."""
        ...


@dataclass(frozen=True)
class Trial:
    """Some episodes of one kind."""

    name: str
    """What the result is called."""
    keywords: dict[str, Any] = field(default_factory=dict)
    """Keywords of `parallel_env`: map, scenario or source, number of agents, time limit."""
    episodes: int = 256
    """How many."""
    seed: int = 1_000_000
    """Of the first episode; the others follow by ones."""

    def make_env(self, policy: Policy, **keywords: Any) -> AnyEnv:
        """Return the environment, as the policy must see it; `keywords` come on top."""
        return make_env(policy, **(self.keywords | keywords))


def make_env(policy: Policy, **keywords: Any) -> AnyEnv:
    """Return the environment of `parallel_env(**keywords)`, as the policy must see it.

    A policy may say so by two attributes: `env_kwargs`, keywords that those given here overrule, and `env_wrappers`,
    pairs of a name in `WRAPPERS` and its keywords, innermost first.
    """
    env: AnyEnv = parallel_env(**(getattr(policy, "env_kwargs", {}) | keywords))
    for name, arguments in getattr(policy, "env_wrappers", ()):
        env = WRAPPERS[name](env, **arguments)
    return env


def play(env: AnyEnv, policy: Policy, seed: int) -> Iterator[float]:
    """Play an episode; yield at its beginning (0.0), and after each step the seconds that the policy took to decide."""
    observations, _ = env.reset(seed=seed)
    policy.reset_states()
    yield 0.0
    while env.agents:
        began = time.perf_counter()
        actions = policy.act(observations)
        seconds = time.perf_counter() - began
        observations = env.step(actions)[0]
        yield seconds


def run_episodes(policy: Policy, trial: Trial) -> Iterator[dict[str, float]]:
    """Yield each episode's metrics, and `runtime`: the seconds that the policy took to decide."""
    env = trial.make_env(policy)
    for episode in range(trial.episodes):
        runtime = sum(play(env, policy, trial.seed + episode))
        yield env.metrics() | {"runtime": runtime}
