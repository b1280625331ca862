"""The workload of a benchmark."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from mapf_pz.instances import FixedMap, RandomObstacles
from mapf_pz.instances.instance import InstanceSource
from mapf_pz.simulator.config import EnvConfig
from mapf_pz.simulator.observation import ObservationLayout
from mapf_pz.simulator.simulator import Simulator
from mapf_pz.simulator.source import make_source

BENCHMARKED = EnvConfig(num_agents=8)
"""The default environment."""
SIDE, DENSITY = 32, 0.2
"""Default height and width, and obstacle density, of random maps."""


@dataclass(frozen=True)
class Workload:
    """Environments with random actions, which are reset when they are finished."""

    env: EnvConfig = BENCHMARKED
    """The environment. If it has no map, scenario or source, maps are random."""
    height: int | None = None
    """Number of rows of a random map. Default: 32."""
    width: int | None = None
    """Number of columns of a random map. Default: 32."""
    density: float | None = None
    """Obstacle density of a random map. Default: 0.2."""
    num_envs: int = 64
    """Number of environments in a batch, for interfaces with batches."""
    num_threads: int = 1
    """Number of threads of the kernels."""
    seed: int = 0
    """Random seed of maps, episodes and actions."""
    new_maps: bool = False
    """Whether every episode has a new random map."""
    complete: bool = False
    """Whether agents also observe the cost to go and the action advantages, and are rewarded for progress."""

    def __post_init__(self) -> None:
        """Raise `ValueError` for settings of random maps if the environment has other maps."""
        given = [name for name in ("height", "width", "density") if getattr(self, name) is not None]
        given += ["new_maps"] * self.new_maps
        for name in ("map", "scenario", "source"):
            if given and getattr(self.env, name) is not None:
                raise ValueError(f"{given[0]}: not allowed together with {name}, which determines maps")

    def env_config(self) -> EnvConfig:
        """Return the configuration of the environments, with the episodes of `source`."""
        env = replace(self.env, map=None, scenario=None, source=self.source)
        if not self.complete:
            return env
        channels = (*env.channels, "cost_to_go")
        return replace(env, channels=channels, features=("action_advantage",), reward="progress")

    @cached_property
    def source(self) -> InstanceSource:
        """The source of instances; raises `ValueError` if there are too many agents for the map."""
        return make_source(self.env, self._random_maps)

    def _random_maps(self, num_agents: int, num_goals: int) -> InstanceSource:
        """Return a source of random maps, or of random instances on one of them."""
        height, width = (SIDE if side is None else side for side in (self.height, self.width))
        density = DENSITY if self.density is None else self.density
        maps = RandomObstacles(height, width, density, num_agents, num_goals)
        if self.new_maps:
            return maps
        return FixedMap(maps.sample(np.random.default_rng(self.seed)).grid, num_agents, num_goals)

    @property
    def num_agents(self) -> int:
        """N, the number of agents."""
        return self.source.num_agents

    @property
    def observation_bytes(self) -> int:
        """Bytes of what each agent observes, without its action mask."""
        layout = ObservationLayout(self.env_config())
        return 4 * (math.prod(layout.image_shape) + layout.num_features)

    def with_env(self, **changes: Any) -> Self:
        """Return the workload with other fields of its environment."""
        return replace(self, env=replace(self.env, **changes))

    def on_random_maps(self, **changes: Any) -> Self:
        """Return the workload on random maps in place of those of its environment, with other fields."""
        return replace(self.with_env(map=None, scenario=None, source=None), **changes)

    def simulator(self) -> Simulator:
        """Return a batch of environments after a reset."""
        simulator = Simulator(self.env_config(), self.num_envs, self.num_threads)
        simulator.reset(seeds={b: self.seed + b for b in range(self.num_envs)})
        return simulator
