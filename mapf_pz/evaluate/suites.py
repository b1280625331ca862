"""Suites: the trials that a policy is judged by, by name."""

from __future__ import annotations

from mapf_pz.evaluate.run import Trial
from mapf_pz.instances.sources import RandomObstacles


def _random(size: int, percent: int, num_agents: int, max_steps: int, episodes: int) -> Trial:
    """Return episodes on random maps of `size` x `size` cells with `percent` % obstacles."""
    return Trial(
        f"{num_agents} agents on random {size} x {size}, {percent} % obstacles",
        {"source": RandomObstacles(size, size, percent / 100, num_agents), "max_steps": max_steps},
        episodes,
    )


_SMALL = _random(12, 15, num_agents=8, max_steps=96, episodes=256)
_CROWD = _random(20, 20, num_agents=32, max_steps=160, episodes=128)
_WAREHOUSE = Trial(
    "10 agents on warehouse-10-20-10-2-1", {"map": "warehouse-10-20-10-2-1", "num_agents": 10, "max_steps": 512}, 64
)

SUITES: dict[str, tuple[Trial, ...]] = {
    "quickstart": (_SMALL, _WAREHOUSE),
    "mappo": (_SMALL, _CROWD, _WAREHOUSE),
    "ippo": (_SMALL, _CROWD, _WAREHOUSE),
    "mappo-cardinal": (_SMALL, _CROWD, _WAREHOUSE),
    "central-ppo": (_random(8, 10, num_agents=4, max_steps=64, episodes=256),),
    "central-ppo-8": (_random(10, 10, num_agents=8, max_steps=64, episodes=256),),
}
"""The suites that come with the project; none of their episodes is seen in training."""
