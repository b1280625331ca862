"""The algorithms by name; others as `package.module:Class`."""

from __future__ import annotations

from typing import cast

from mapf_pz._internal.plugins import import_subclass
from mapf_pz.rl.algorithms.algorithm import Algorithm
from mapf_pz.rl.algorithms.behavior_cloning import BehaviorCloning
from mapf_pz.rl.algorithms.imitation import Dagger
from mapf_pz.rl.algorithms.ppo import IPPO, MAPPO, CentralPPO
from mapf_pz.rl.config import AlgorithmName

ALGORITHMS: dict[AlgorithmName, type[Algorithm]] = {
    "mappo": MAPPO,
    "ippo": IPPO,
    "central-ppo": CentralPPO,
    "dagger": Dagger,
    "bc": BehaviorCloning,
}
"""The built-in algorithms by name."""


def algorithm_of(name: str) -> type[Algorithm]:
    """Return the algorithm that a configuration names; raises `ValueError` if `package.module:Class` is not one."""
    if ":" not in name:
        return ALGORITHMS[cast("AlgorithmName", name)]
    return import_subclass("algorithm", name, Algorithm)
