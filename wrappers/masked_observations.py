"""`MaskedObservations`: action masks in the observations, for trainers that read them there."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from pettingzoo import ParallelEnv

from mapf_pz.environment.mapf_env import AgentInfo
from mapf_pz.wrappers.observation_wrapper import ObservationWrapper


class MaskedObservations(ObservationWrapper):
    """The observation of each agent is `Dict(observation=..., action_mask=Box(0, 1, (A,), int8))`.

    These are PettingZoo's names; the mask is that of the infos, 1 for actions that the map allows.
    """

    def __init__(self, env: ParallelEnv[str, Any, Any]) -> None:
        """Wrap `env`, a `MapfEnv` or a wrapper of one, with discrete actions; otherwise, raises `TypeError`."""
        first = env.possible_agents[0]
        actions = env.action_space(first)
        if not isinstance(actions, spaces.Discrete):
            raise TypeError(f"action space {actions}: expected Discrete")
        mask = spaces.Box(0, 1, (int(actions.n),), np.int8)
        super().__init__(env, spaces.Dict(observation=env.observation_space(first), action_mask=mask))

    def observation(self, observed: Any, info: AgentInfo) -> dict[str, Any]:
        """Return the observation together with the mask."""
        return {"observation": observed, "action_mask": info["action_mask"]}
