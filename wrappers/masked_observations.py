"""`MaskedObservations`: action masks in the observations, for trainers that read them there."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from pettingzoo import ParallelEnv

from mapf_pz.environment.mapf_env import AgentInfo
from mapf_pz.wrappers.observation_wrapper import ObservationWrapper
from mapf_pz.wrappers.wrapped import discrete_space, without_masks


class MaskedObservations(ObservationWrapper):
    """The observation of each agent is `Dict(observation=..., action_mask=Box(0, 1, (A,), int8))`.

    These are PettingZoo's names; the mask is that of the infos, 1 for actions that the map allows. The infos of this
    wrapper have no mask: TorchRL requires that there is only one.
    """

    def __init__(self, env: ParallelEnv[str, Any, Any]) -> None:
        """Wrap `env`, a `MapfEnv` or a wrapper of one, with discrete actions; otherwise, raises `TypeError`."""
        mask = spaces.Box(0, 1, (int(discrete_space(env).n),), np.int8)
        observation = env.observation_space(env.possible_agents[0])
        super().__init__(env, spaces.Dict(observation=observation, action_mask=mask))

    def observation(self, observed: Any, info: AgentInfo) -> dict[str, Any]:
        """Return the observation together with the mask."""
        return {"observation": observed, "action_mask": info["action_mask"]}

    def infos(self, given: dict[str, AgentInfo]) -> dict[str, AgentInfo]:
        """Return the infos without masks."""
        return without_masks(given)
