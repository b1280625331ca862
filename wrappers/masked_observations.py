"""`MaskedObservations`: action masks in the observations, for trainers that read them there."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
from gymnasium import spaces
from pettingzoo import ParallelEnv
from pettingzoo.utils import BaseParallelWrapper

from mapf_pz.environment import AgentInfo, StepResult


class MaskedObservations(BaseParallelWrapper[str, Any, Any]):
    """The observation of each agent is `Dict(observation=..., action_mask=Box(0, 1, (A,), int8))`.

    These are PettingZoo's names; the mask is that of the infos, 1 for actions that the map allows.
    """

    def __init__(self, env: ParallelEnv[str, Any, Any]) -> None:
        """Wrap `env`, a `MapfEnv` or a wrapper of one, with discrete actions; otherwise, raises `TypeError`."""
        super().__init__(env)
        first = env.possible_agents[0]
        actions = env.action_space(first)
        if not isinstance(actions, spaces.Discrete):
            raise TypeError(f"action space {actions}: expected Discrete")
        mask = spaces.Box(0, 1, (int(actions.n),), np.int8)
        space = spaces.Dict(observation=env.observation_space(first), action_mask=mask)
        self.observation_spaces = dict.fromkeys(env.possible_agents, space)

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """Return the observation space of an agent, which is the same object for all agents and calls."""
        return self.observation_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, dict[str, Any]], dict[str, AgentInfo]]:
        """Start an episode, as `MapfEnv.reset` does."""
        observations, infos = self.env.reset(seed=seed, options=options)
        return _masked(observations, infos), infos

    def step(self, actions: dict[str, Any]) -> StepResult:
        """Take one step, as `MapfEnv.step` does."""
        observations, *rest, infos = self.env.step(actions)
        return cast("StepResult", (_masked(observations, infos), *rest, infos))


def _masked(observations: dict[str, Any], infos: dict[str, AgentInfo]) -> dict[str, dict[str, Any]]:
    return {
        agent: {"observation": seen, "action_mask": infos[agent]["action_mask"]} for agent, seen in observations.items()
    }
