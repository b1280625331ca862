"""`to_aec`: the AEC form of a wrapped environment."""

from __future__ import annotations

from typing import Any

from pettingzoo import AECEnv, ParallelEnv

from mapf_pz.environment.mapf_env import MapfAecEnv, OrderEnforced
from mapf_pz.wrappers.wrapped import wrapped_env


def to_aec(env: ParallelEnv[str, Any, Any]) -> AECEnv[str, Any, Any]:
    """Return the AEC form of `env`, a `MapfEnv` or a wrapper of one, in which agents act sequentially.

    As that of `mapf_pz.env`, it has `metrics()` and the members of `MapfEnv` in `unwrapped`, which describe the last
    complete step. Raises `TypeError` for another environment.
    """
    wrapped_env(env)
    return OrderEnforced(MapfAecEnv(env))
