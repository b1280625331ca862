"""Multi-agent path finding (MAPF) on standard benchmark maps, as a PettingZoo environment.

Importing this package is quick: names are loaded when they are first used, and nothing is compiled.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import gymnasium
import pettingzoo

from mapf_pz._internal.lazy import lazy_attributes

if TYPE_CHECKING:
    from mapf_pz.simulator.actions import Action, CardinalAction, Heading
    from mapf_pz.simulator.config import EnvConfig
    from mapf_pz.simulator.kernels.observation.channels import Channel
    from mapf_pz.simulator.kernels.observation.features import Feature
    from mapf_pz.simulator.kernels.reward import RewardConfig
    from mapf_pz.environment.mapf_env import MapfEnv, env, parallel_env
    from mapf_pz.errors import FormatError
    from mapf_pz.guidance import GuidanceGraph
    from mapf_pz.instances.instance import Grid, Instance, InstanceSource, Scenario
    from mapf_pz.simulator.recommended import RECOMMENDED
    from mapf_pz.simulator.transition import Transition
    from mapf_pz._internal.version import __version__

_HOMES = {
    "RECOMMENDED": "recommended",
    "__version__": "version",
    "Action": "actions",
    "CardinalAction": "actions",
    "Channel": "core.observation.channels",
    "EnvConfig": "config",
    "Feature": "core.observation.features",
    "FormatError": "errors",
    "Grid": "instance",
    "GuidanceGraph": "guidance",
    "Heading": "actions",
    "Instance": "instance",
    "InstanceSource": "instance",
    "MapfEnv": "environment",
    "RewardConfig": "core.reward",
    "Scenario": "instance",
    "Transition": "transition",
    "env": "environment",
    "parallel_env": "environment",
}

__all__ = [
    "RECOMMENDED",
    "Action",
    "CardinalAction",
    "Channel",
    "EnvConfig",
    "Feature",
    "FormatError",
    "Grid",
    "GuidanceGraph",
    "Heading",
    "Instance",
    "InstanceSource",
    "MapfEnv",
    "RewardConfig",
    "Scenario",
    "Transition",
    "__version__",
    "env",
    "parallel_env",
]


__getattr__ = lazy_attributes(__name__, _HOMES)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])


pettingzoo.register("parallel", "mapf_pz/Mapf-v0", entry_point="mapf_pz.environment.mapf_env:parallel_env")
pettingzoo.register("aec", "mapf_pz/Mapf-v0", entry_point="mapf_pz.environment.mapf_env:env")
gymnasium.register(
    "Mapf-Centralized-v0",
    entry_point="mapf_pz.wrappers.centralized:centralized_env",
    vector_entry_point="mapf_pz.wrappers.centralized_vector:CentralizedVectorEnv",
)
