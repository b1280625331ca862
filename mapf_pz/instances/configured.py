"""The source that a configuration asks for."""

from __future__ import annotations

from mapf_pz.config import EnvConfig
from mapf_pz.instances.library import load_map, load_scenario
from mapf_pz.instances.sources import FixedMap, FixedScenario
from mapf_pz.types import InstanceSource


def goals_per_agent(config: EnvConfig) -> int:
    """Return how many goals an agent may need in one episode."""
    return config.max_steps + 1 if config.on_target == "restart" else 1


def make_source(config: EnvConfig) -> InstanceSource:
    """Return `config.source`, or one that draws from `config.map` or takes `config.scenario`."""
    if config.source is not None:
        return config.source
    grid = load_map(config.map)
    if config.scenario is None:
        return FixedMap(grid, config.num_agents, goals_per_agent(config))
    return FixedScenario(grid, load_scenario(config.scenario, grid), config.num_agents)
