"""The recommended observation and reward for training."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from mapf_pz.simulator.kernels.reward import REWARDS

RECOMMENDED: Mapping[str, Any] = MappingProxyType(
    {
        "view_size": (7, 7),
        "view": "centered",
        "channels": ("view", "cost_to_go", "orientation", "others_next", "others_at_goal"),
        "features": ("action_advantage", "last_actions"),
        "num_last_actions": 2,
        "reward": REWARDS["progress"],
    }
)
"""Keywords of `parallel_env` from which policies learn: `parallel_env(**RECOMMENDED, num_agents=8)`.

The channel `cost_to_go` and the feature `action_advantage` show each agent its way, and the reward pays for each step
on it. The trainers' presets use the same observation and reward. The environment's defaults are those of the report,
from which no policy learned.
"""
