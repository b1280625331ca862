"""`FlatObservations`: observations as vectors, for libraries that do not support dictionaries or small images."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

from mapf_pz.environment.mapf_env import AgentInfo
from mapf_pz.wrappers.observation_wrapper import ObservationWrapper
from mapf_pz.wrappers.wrapped import wrapped_env


class FlatObservations(ObservationWrapper):
    """The observation of each agent is a vector, `Box(low, high, (P,), float32)`: the image, then the features.

    The vector can be stacked by SuperSuit's `frame_stack_v1`, which stacks images of this package along their width.
    """

    def __init__(self, env: ParallelEnv[str, Any, Any]) -> None:
        """Wrap `env`, a `MapfEnv` or a wrapper of one with the same observations; otherwise, raises `TypeError`."""
        wrapped_env(env)
        given = env.observation_space(env.possible_agents[0])
        if isinstance(given, spaces.Dict) and set(given.spaces) != {"image", "features"}:
            raise TypeError(f"env: expected observations of an image and features, got {given}")
        boxes = _parts(given)
        low, high = (np.concatenate([getattr(box, bound).ravel() for box in boxes]) for bound in ("low", "high"))
        super().__init__(env, spaces.Box(low, high, dtype=np.float32))

    def observation(self, observed: Any, info: AgentInfo) -> NDArray[np.float32]:
        """Return the vector."""
        return np.concatenate([part.ravel() for part in _parts(observed)])


def _parts(whole: Any) -> list[Any]:
    """Return the image and the features of an observation or of its space; without features, the image alone."""
    return [whole["image"], whole["features"]] if isinstance(whole, (dict, spaces.Dict)) else [whole]
