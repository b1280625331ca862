"""The source of episodes for a configuration."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from mapf_pz.instances.instance import Instance, InstanceSource, Scenario
from mapf_pz.instances.library import DEFAULT_MAP, load_map
from mapf_pz.instances.load import load_instances, sample_headings
from mapf_pz.instances.sources import FixedMap, InstanceList
from mapf_pz.instances.warehouse import WarehouseTasks, load_warehouse
from mapf_pz.simulator.config import DEFAULT_NUM_AGENTS, EnvConfig


def goals_per_agent(config: EnvConfig) -> int:
    """Return the maximum number of goals that an agent may need in one episode."""
    return config.max_steps + 1 if config.on_target == "restart" else 1


def make_source(config: EnvConfig, otherwise: Callable[[int, int], InstanceSource] | None = None) -> InstanceSource:
    """Return `config.source`, or else a source of the instances of `config.scenario` or of random ones on `config.map`.

    Without source, scenario and map, it is the source that `otherwise` returns for the numbers of agents and of goals
    per agent, or one of random instances on the default map.

    Raises as `load_map`, `load_instances` and `load_warehouse` do, and as `otherwise` does.
    """
    source = config.resolved_source
    if source is not None:
        return source
    if config.scenarios:
        return InstanceList(load_instances(config.scenarios, config.map, config.num_agents, goals_per_agent(config)))
    num_agents, num_goals = config.num_agents or DEFAULT_NUM_AGENTS, goals_per_agent(config)
    if config.map is None and otherwise is not None:
        return otherwise(num_agents, num_goals)
    map = DEFAULT_MAP if config.map is None else config.map
    if config.goals == "alternating":
        if not isinstance(map, (str, Path)):
            raise ValueError("goals='alternating': expected a map's name or file, which says where the stations are")
        return WarehouseTasks(*load_warehouse(map), num_agents, num_goals)
    return FixedMap(load_map(map), num_agents, num_goals)


def sample_instance(config: EnvConfig, seed: int) -> Instance:
    """Return an instance of `make_source(config)` for planners: one goal per agent, and headings if agents rotate.

    Headings of a problem file take precedence over `config.initial_heading`.
    """
    rng = np.random.default_rng(seed)
    instance = make_source(config).sample(rng)
    scenario, headings = instance.scenario, instance.headings
    if scenario.goals.ndim > 2:
        scenario = Scenario(scenario.starts, scenario.goals[:, 0])
    if config.action_model == "cardinal":
        headings = None
    elif headings is None:
        headings = sample_headings(config.initial_heading, instance.num_agents, rng)
    return Instance(instance.grid, scenario, headings)
