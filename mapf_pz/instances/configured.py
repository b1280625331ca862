"""The source that a configuration asks for."""

from __future__ import annotations

from mapf_pz.config import DEFAULT_MAP, DEFAULT_NUM_AGENTS, EnvConfig
from mapf_pz.instance import InstanceSource
from mapf_pz.instances.library import load_map, load_scenario
from mapf_pz.instances.sources import FixedMap, FixedScenario


def goals_per_agent(config: EnvConfig) -> int:
    """Return how many goals an agent may need in one episode."""
    return config.max_steps + 1 if config.on_target == "restart" else 1


def make_source(config: EnvConfig) -> InstanceSource:
    """Return `config.source`, or one that draws from `config.map` or takes `config.scenario`."""
    if config.source is not None:
        return config.source
    grid = load_map(DEFAULT_MAP if config.map is None else config.map)
    if config.scenario is None:
        return FixedMap(grid, config.num_agents or DEFAULT_NUM_AGENTS, goals_per_agent(config))
    scenario = load_scenario(config.scenario, grid)
    return FixedScenario(grid, scenario, config.num_agents or len(scenario))
