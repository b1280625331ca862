"""Suites: the trials that a policy is judged by, by name."""

from __future__ import annotations

from mapf_pz.evaluate.run import Trial
from mapf_pz.instances.sources import RandomObstacles

SUITES: dict[str, tuple[Trial, ...]] = {
    "quickstart": (
        Trial(
            "8 agents on random 12 x 12, 15 % obstacles",
            {"source": RandomObstacles(12, 12, 0.15, 8), "max_steps": 96},
            episodes=256,
        ),
        Trial(
            "10 agents on warehouse-10-20-10-2-1",
            {"map": "warehouse-10-20-10-2-1", "num_agents": 10, "max_steps": 512},
            episodes=64,
        ),
    ),
    "central-ppo": (
        Trial(
            "4 agents on random 8 x 8, 10 % obstacles",
            {"source": RandomObstacles(8, 8, 0.1, 4), "max_steps": 64},
            episodes=256,
        ),
    ),
}
"""The suites that come with the project; none of their episodes is seen in training."""
