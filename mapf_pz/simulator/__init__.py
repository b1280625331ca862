"""B environments of N agents as arrays: their configuration, actions, observations and metrics.

It imports instances, guidance graphs and what is internal. Read `kernels/step.py` first: one step of the environment.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from mapf_pz._internal.lazy import lazy_attributes

if TYPE_CHECKING:
    from mapf_pz.simulator.actions import Action, CardinalAction
    from mapf_pz.simulator.config import EnvConfig
    from mapf_pz.simulator.kernels.reward import RewardConfig
    from mapf_pz.simulator.simulator import Simulator
    from mapf_pz.simulator.transition import Transition

_HOMES = {
    "Action": "actions",
    "CardinalAction": "actions",
    "EnvConfig": "config",
    "RewardConfig": "kernels.reward",
    "Simulator": "simulator",
    "Transition": "transition",
}

__all__ = ["Action", "CardinalAction", "EnvConfig", "RewardConfig", "Simulator", "Transition"]

__getattr__ = lazy_attributes(__name__, _HOMES)


def __dir__() -> list[str]:
    return sorted(__all__)
