"""What the wrappers share: their base class, checks of the environments that they are given, infos without masks."""

from __future__ import annotations

from typing import Any

from gymnasium import spaces
from pettingzoo import ParallelEnv
from pettingzoo.utils import BaseParallelWrapper

from mapf_pz.environment.mapf_env import AgentInfo, MapfEnv


class MapfWrapper(BaseParallelWrapper[str, Any, Any]):
    """A wrapper of a `MapfEnv` or of a wrapper of one."""

    def __repr__(self) -> str:
        """Return the wrapper and what it wraps in one line."""
        return f"{type(self).__name__}({self.env!r})"


def wrapped_env(env: object) -> MapfEnv:
    """Return the `MapfEnv` that `env` is or wraps; raises `TypeError` for anything else, such as the AEC form."""
    if not isinstance(env, ParallelEnv) or not isinstance(env.unwrapped, MapfEnv):
        raise TypeError(f"env: expected a MapfEnv or a wrapper of one, got {type(env).__name__}")
    return env.unwrapped


def discrete_space(env: ParallelEnv[str, Any, Any]) -> spaces.Discrete:
    """Return the action space of the agents of `env`; raises `TypeError` unless `env` is a discrete `MapfEnv`."""
    wrapped_env(env)
    space = env.action_space(env.possible_agents[0])
    if not isinstance(space, spaces.Discrete):
        raise TypeError(f"env: expected discrete actions, got {space}")
    return space


def unmasked_space(env: ParallelEnv[str, Any, Any]) -> spaces.Discrete:
    """Return the action space of the agents of `env`; raises `TypeError` also if their observations have masks."""
    space, observed = discrete_space(env), env.observation_space(env.possible_agents[0])
    if isinstance(observed, spaces.Dict) and "action_mask" in observed.spaces:
        raise TypeError("env: expected observations without action masks")
    return space


def without_masks(infos: dict[str, AgentInfo]) -> dict[str, AgentInfo]:
    """Return the infos without `action_mask`."""
    return {
        agent: {name: value for name, value in info.items() if name != "action_mask"} for agent, info in infos.items()
    }
