"""What acts: the protocol of policies.

Planners, learned policies, the safety layer, plans of other programs and objects of users implement it. A policy has
the methods of `Policy`, and states more by optional members:

| member | meaning |
| --- | --- |
| `env_kwargs` | keywords of `parallel_env` that an environment for the policy has: see `make_env` |
| `needs_infos = True` | it acts as `act(observations, infos)`, for example on action masks |
| `preferences(observations)` | scores of all actions, which the safety layer executes: see `Preferring` |
| `in_batch(simulator)` | it acts in several episodes at the same time: see `BatchPolicy` |
| `identity` | text that changes whenever the policy's behavior changes, so that its results can be reused |
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol, TypeAlias, cast, runtime_checkable

from pettingzoo.utils import BaseParallelWrapper

from mapf_pz._internal.arrays import Floats, Ints
from mapf_pz.environment.mapf_env import AgentObservation, MapfEnv, parallel_env
from mapf_pz.simulator.simulator import Observation, Simulator

AnyEnv: TypeAlias = "MapfEnv | BaseParallelWrapper[str, AgentObservation, Any]"
"""A `MapfEnv`, or a wrapper of one, which has the same attributes."""


class Policy(Protocol):
    """A policy of all agents in one environment; the methods are those of POGEMA's toolbox."""

    def act(self, observations: dict[str, Any]) -> dict[str, int]:
        """Return an action for each agent in `observations`."""
        ...

    def reset_states(self) -> None:
        """Reset all per-episode state. Called before each episode."""
        ...


@runtime_checkable
class Preferring(Protocol):
    """A policy that returns preferences over actions, not just one action."""

    def preferences(self, observations: dict[str, Any]) -> dict[str, Floats]:
        """Return the preferences (A,) of each agent in `observations`; higher is better."""
        ...

    def reset_states(self) -> None:
        """Reset all per-episode state. Called before each episode."""
        ...


@runtime_checkable
class BatchPolicy(Protocol):
    """A policy that acts in several environments at the same time."""

    def in_batch(self, simulator: Simulator) -> PolicyInBatch | None:
        """Return the policy in all environments of a simulator; None: it acts in single environments only."""
        ...


class PolicyInBatch(Protocol):
    """A policy in all environments of a simulator. In each of them it acts as in a single environment."""

    def reset(self, b: int) -> None:
        """Reset all per-episode state of environment `b`. Called before each episode."""
        ...

    def actions(self, observation: Observation, envs: Sequence[int]) -> Ints:
        """Return actions (B, N) int64.

        Args:
            observation: what the agents of all B environments observe.
            envs: the environments to act in; actions in the others have no effect, but must be valid.
        """
        ...


class PreferringInBatch(Protocol):
    """A policy that returns preferences in all environments of a simulator."""

    def reset(self, b: int) -> None:
        """Reset all per-episode state of environment `b`. Called before each episode."""
        ...

    def preferences(self, observation: Observation, envs: Sequence[int]) -> Floats:
        """Return preferences (B, N, A) in the environments `envs`, and any finite numbers in the others."""
        ...


PolicyFactory: TypeAlias = "Callable[[dict[str, Any]], tuple[AnyEnv, Policy]]"
"""Makes the environment that the policy requires, and the policy, from keyword arguments of `parallel_env`."""


def check_policy(policy: object) -> None:
    """Raise `TypeError` unless `policy` is an object with the methods of `Policy`."""
    if isinstance(policy, type):
        raise TypeError(f"policy {policy.__name__}: expected an object, such as {policy.__name__}(), got the class")
    for method in ("act", "reset_states"):
        if not callable(getattr(policy, method, None)):
            raise TypeError(
                f"policy {type(policy).__name__}: expected the methods act and reset_states, not found: {method}"
            )


def make_env(policy: Policy, **keywords: Any) -> MapfEnv:
    """Return the environment `parallel_env(**keywords)`, with the settings that the policy requires.

    A policy states them in an attribute `env_kwargs`: keyword arguments, which are overridden by `keywords`.
    """
    return parallel_env(**(getattr(policy, "env_kwargs", {}) | keywords))


def actions_of(policy: Policy, observations: dict[str, Any], infos: dict[str, Any]) -> dict[str, int]:
    """Return the policy's actions; a policy with `needs_infos` also gets the infos."""
    act: Callable[..., dict[str, int]] = policy.act
    return act(observations, infos) if getattr(policy, "needs_infos", False) else act(observations)


def simulator_of(env: AnyEnv) -> Simulator:
    """Return the simulator of an environment or of a wrapped environment."""
    return cast("MapfEnv", env.unwrapped).simulator
