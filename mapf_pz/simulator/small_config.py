"""A configuration like another one, for a small map: its kernels are the same."""

from __future__ import annotations

import dataclasses

import numpy as np

from mapf_pz.instances.instance import Grid, Instance, Scenario
from mapf_pz.instances.sources import InstanceList
from mapf_pz.simulator.config import EnvConfig
from mapf_pz.simulator.kernels.observation.channels import CHANNELS
from mapf_pz.simulator.kernels.observation.features import FEATURES

MAX_STEPS = 2


def small_config(config: EnvConfig, num_agents: int) -> EnvConfig:
    """Return a configuration with short episodes on a small map, and without what users define.

    Each of the agents is in a separate corridor.
    """
    rows = np.arange(num_agents)
    scenario = Scenario(np.stack([rows, 0 * rows], axis=1), np.stack([rows, 0 * rows + 1], axis=1))
    instance = Instance(Grid(np.ones((num_agents, 2), np.bool_)), scenario)
    return dataclasses.replace(
        config,
        map=None,
        scenario=None,
        source=InstanceList([instance]),
        num_agents=None,
        goals="uniform",
        max_steps=MAX_STEPS,
        initial_heading="east",
        edge_weights="uniform" if config.edge_weights == "uniform" else "crisscross",
        channels=tuple(name for name in config.channels if name in CHANNELS) or ("view",),
        features=tuple(name for name in config.features if name in FEATURES),
        reward=config.reward_config,
        distance_bytes=None,
    )
