"""The infos of the PettingZoo environment."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapf_pz._internal.arrays import Ints

AgentInfo = dict[str, Any]

_FLAGS = ("at_goal", "arrived", "blocked", "moved")
_TEMPLATES: list[AgentInfo] = [
    {"action_mask": None, **{flag: bits >> k & 1 for k, flag in enumerate(_FLAGS)}, "arrivals": 0}
    for bits in range(2 ** len(_FLAGS))
]
"""An info for each combination of flags: copying one is faster than building a dictionary of six values."""


def agent_infos(names: list[str], agents: NDArray[np.void], action_mask: Ints) -> dict[str, AgentInfo]:
    """Return the infos of N agents by name.

    Args:
        names: Names of the agents (N).
        agents: Their records, (N,) AGENT.
        action_mask: Their action masks, (N, A) int8, of which the infos contain views.
    """
    flags = (agents["at_goal"], agents["arrived"], agents["blocked"], agents["cell"] != agents["was_cell"])
    bits = np.packbits(flags, axis=0, bitorder="little")[0]  # (N,), flag k of _FLAGS is bit k
    infos: dict[str, AgentInfo] = {}
    for name, mask, k, arrivals in zip(names, action_mask, bits.tolist(), agents["arrivals"].tolist(), strict=True):
        infos[name] = info = _TEMPLATES[k].copy()
        info["action_mask"] = mask
        info["arrivals"] = arrivals
    return infos
