"""`FlatObservations`: observations as vectors, for libraries that do not support dictionaries or small images."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from pettingzoo import ParallelEnv
from pettingzoo.utils import BaseParallelWrapper

from mapf_pz.environment import AgentInfo, StepResult


class FlatObservations(BaseParallelWrapper[str, Any, Any]):
    """The observation of each agent is a vector, `Box(low, high, (P,), float32)`: the image, then the features.

    The vector can be stacked by SuperSuit's `frame_stack_v1`, which stacks images of this package along their width.
    """

    def __init__(self, env: ParallelEnv[str, Any, Any]) -> None:
        """Wrap `env`, a `MapfEnv` or a wrapper of one with the same observations."""
        super().__init__(env)
        boxes = _parts(env.observation_space(env.possible_agents[0]))
        low, high = (np.concatenate([getattr(box, bound).ravel() for box in boxes]) for bound in ("low", "high"))
        self.observation_spaces = dict.fromkeys(env.possible_agents, spaces.Box(low, high, dtype=np.float32))

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """Return the observation space of an agent, which is the same object for all agents and calls."""
        return self.observation_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, NDArray[np.float32]], dict[str, AgentInfo]]:
        """Start an episode, as `MapfEnv.reset` does."""
        observations, infos = self.env.reset(seed=seed, options=options)
        return _flat(observations), infos

    def step(self, actions: dict[str, Any]) -> StepResult:
        """Take one step, as `MapfEnv.step` does."""
        observations, *rest = self.env.step(actions)
        return cast("StepResult", (_flat(observations), *rest))


def _parts(whole: Any) -> list[Any]:
    """Return the image and the features of an observation or of its space; without features, the image alone."""
    return [whole["image"], whole["features"]] if isinstance(whole, (dict, spaces.Dict)) else [whole]


def _flat(observations: dict[str, Any]) -> dict[str, NDArray[np.float32]]:
    return {agent: np.concatenate([part.ravel() for part in _parts(seen)]) for agent, seen in observations.items()}
