"""The PettingZoo environment: `parallel_env`, its AEC form `env`, and their class `MapfEnv`.

It imports the simulator and rendering. Read `mapf_env.py` first.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from mapf_pz._internal.lazy import lazy_attributes

if TYPE_CHECKING:
    from mapf_pz.environment.mapf_env import MapfEnv, env, parallel_env

_HOMES = {
    "MapfEnv": "mapf_env",
    "env": "mapf_env",
    "parallel_env": "mapf_env",
}

__all__ = ["MapfEnv", "env", "parallel_env"]

__getattr__ = lazy_attributes(__name__, _HOMES)


def __dir__() -> list[str]:
    return sorted(__all__)
