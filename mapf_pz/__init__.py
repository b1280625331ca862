"""Multi-agent path finding (MAPF) on standard benchmark maps, as a PettingZoo environment.

Importing this package is quick: names and packages are loaded when they are first used, and nothing is compiled.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import gymnasium
import pettingzoo

from mapf_pz._internal.lazy import lazy_attributes

if TYPE_CHECKING:
    from mapf_pz import evaluation, guidance, instances, optimization, planners, render, rl, simulator, wrappers
    from mapf_pz._internal.version import __version__
    from mapf_pz.environment.mapf_env import MapfEnv, env, parallel_env
    from mapf_pz.errors import FormatError
    from mapf_pz.guidance import GuidanceGraph
    from mapf_pz.instances.heading import Heading
    from mapf_pz.instances.instance import Grid, Instance, InstanceSource, Scenario
    from mapf_pz.instances.sources import RandomObstacles
    from mapf_pz.simulator.actions import Action, CardinalAction
    from mapf_pz.simulator.config import EnvConfig
    from mapf_pz.simulator.kernels.observation.channels import Channel
    from mapf_pz.simulator.kernels.observation.features import Feature
    from mapf_pz.simulator.kernels.reward import RewardConfig
    from mapf_pz.simulator.recommended import RECOMMENDED
    from mapf_pz.simulator.transition import Transition

_HOMES = {
    "RECOMMENDED": "simulator.recommended",
    "__version__": "_internal.version",
    "Action": "simulator.actions",
    "CardinalAction": "simulator.actions",
    "Channel": "simulator.kernels.observation.channels",
    "EnvConfig": "simulator.config",
    "Feature": "simulator.kernels.observation.features",
    "FormatError": "errors",
    "Grid": "instances.instance",
    "GuidanceGraph": "guidance",
    "Heading": "instances.heading",
    "Instance": "instances.instance",
    "InstanceSource": "instances.instance",
    "MapfEnv": "environment.mapf_env",
    "RandomObstacles": "instances.sources",
    "RewardConfig": "simulator.kernels.reward",
    "Scenario": "instances.instance",
    "Transition": "simulator.transition",
    "env": "environment.mapf_env",
    "parallel_env": "environment.mapf_env",
}

_PACKAGES = ("evaluation", "guidance", "instances", "optimization", "planners", "render", "rl", "simulator", "wrappers")

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
    "RandomObstacles",
    "RewardConfig",
    "Scenario",
    "Transition",
    "__version__",
    "env",
    "evaluation",
    "guidance",
    "instances",
    "optimization",
    "parallel_env",
    "planners",
    "render",
    "rl",
    "simulator",
    "wrappers",
]


__getattr__ = lazy_attributes(__name__, _HOMES, _PACKAGES)


def __dir__() -> list[str]:
    return sorted(__all__)


pettingzoo.register("parallel", "mapf_pz/Mapf-v0", entry_point="mapf_pz.environment:parallel_env")
pettingzoo.register("aec", "mapf_pz/Mapf-v0", entry_point="mapf_pz.environment:env")
gymnasium.register(
    "Mapf-Centralized-v0",
    entry_point="mapf_pz.wrappers.centralized:centralized_env",
    vector_entry_point="mapf_pz.wrappers.centralized_vector:CentralizedVectorEnv",
)
gymnasium.register("Mapf-Agents-v0", vector_entry_point="mapf_pz.wrappers.agent_vector:AgentVectorEnv")
