"""Small datasets for the tests."""

from mapf_pz.instances.mixture import MapMixture
from mapf_pz.rl.demonstrations import DatasetConfig
from mapf_pz.simulator.config import EnvConfig

MIXTURE = MapMixture(maps=("random", "maze"), height=(6, 8), width=8)


def small(**changes):
    """Return the settings of a dataset of five episodes for each of two numbers of agents, in six shards."""
    keywords = {"planner": "pibt", "mixture": MIXTURE, "num_agents": (2, 4), "episodes": 5, "shard_size": 2, "seed": 3}
    return DatasetConfig(**({"env": EnvConfig(max_steps=40)} | keywords | changes))
