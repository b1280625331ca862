"""Base class of wrappers that stack several observations along the planes and features."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any, cast

import numpy as np
from gymnasium import spaces
from pettingzoo import ParallelEnv
from pettingzoo.utils import BaseParallelWrapper

from mapf_pz.environment import AgentInfo, AgentObservation, StepResult


class StackingWrapper(BaseParallelWrapper[str, AgentObservation, Any]):
    """Stacks `number` observations for each agent."""

    def __init__(self, env: ParallelEnv[str, AgentObservation, Any], number: int) -> None:
        """Wrap `env`."""
        super().__init__(env)
        space = stacked_space(env.observation_space(env.possible_agents[0]), number)
        self.observation_spaces = dict.fromkeys(env.possible_agents, space)

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """Return the observation space of an agent, which is the same object for all agents and calls."""
        return self.observation_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, AgentObservation], dict[str, AgentInfo]]:
        """Start an episode, as `MapfEnv.reset` does."""
        observations, infos = self.env.reset(seed=seed, options=options)
        self._start(observations)
        return self._stack(observations), infos

    def step(self, actions: dict[str, Any]) -> StepResult:
        """Take one step, as `MapfEnv.step` does."""
        observations, rewards, terminations, truncations, infos = self.env.step(actions)
        return self._stack(observations), rewards, terminations, truncations, infos

    def _start(self, observations: dict[str, AgentObservation]) -> None:
        """Prepare for an episode, given its first observations."""

    @abstractmethod
    def _stack(self, observations: dict[str, AgentObservation]) -> dict[str, AgentObservation]:
        """Return the stacked observations, in new arrays."""


def stacked(parts: Sequence[Any]) -> Any:
    """Concatenate arrays along their first axis; for dictionaries, the arrays of each key."""
    if isinstance(parts[0], dict):
        return {key: stacked([part[key] for part in parts]) for key in parts[0]}
    return np.concatenate(parts)


def stacked_space(space: spaces.Space[Any], number: int) -> spaces.Space[Any]:
    """Return the space of `number` stacked observations of `space`, a Box or a Dict of them."""
    if isinstance(space, spaces.Dict):
        return spaces.Dict({key: stacked_space(part, number) for key, part in space.items()})
    box = cast("spaces.Box", space)
    return spaces.Box(np.concatenate([box.low] * number), np.concatenate([box.high] * number), dtype=np.float32)


def zeros(space: spaces.Space[Any]) -> Any:
    """Return an observation of `space`, a Box or a Dict of them, with all zeros."""
    if isinstance(space, spaces.Dict):
        return {key: zeros(part) for key, part in space.items()}
    return np.zeros(space.shape or (), np.float32)
