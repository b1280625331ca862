"""The workload of a benchmark."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mapf_pz.config import EnvConfig
from mapf_pz.instance import InstanceSource
from mapf_pz.instances import FixedMap, RandomObstacles, load_map
from mapf_pz.simulator import Simulator


@dataclass(frozen=True)
class Workload:
    """Environments with random actions, which are reset when they are finished."""

    map: str | None = None
    """Name of a map, or path of a `.map` file. None: a random map."""
    height: int = 32
    """Number of rows of a random map."""
    width: int = 32
    """Number of columns of a random map."""
    density: float = 0.2
    """Obstacle density of a random map."""
    num_agents: int = 8
    """Number of agents."""
    num_envs: int = 64
    """Number of environments in a batch, for interfaces with batches."""
    num_threads: int = 1
    """Number of threads of the kernels."""
    view_size: tuple[int, int] = EnvConfig.view_size
    """Rows and columns of each agent's view."""
    max_steps: int = EnvConfig.max_steps
    """Number of steps of an episode, and of a run."""
    seed: int = 0
    """Random seed of maps, episodes and actions."""
    new_maps: bool = False
    """Whether every episode has a new random map."""
    complete: bool = False
    """Whether agents also observe the cost to go and the action advantages, and are rewarded for progress."""

    def keywords(self) -> dict[str, Any]:
        """Return the keyword arguments of `parallel_env`."""
        keywords: dict[str, Any] = {"view_size": self.view_size, "max_steps": self.max_steps}
        if self.complete:
            channels = (*EnvConfig.channels, "cost_to_go")
            keywords |= {"channels": channels, "features": ("action_advantage",), "reward": "progress"}
        return keywords | {"source": self.source()}

    def source(self) -> InstanceSource:
        """Return the source of instances; raises `ValueError` if there are too many agents for the map."""
        if self.map is not None:
            return FixedMap(load_map(self.map), self.num_agents)
        maps = RandomObstacles(self.height, self.width, self.density, self.num_agents)
        return maps if self.new_maps else FixedMap(maps.sample(np.random.default_rng(self.seed)).grid, self.num_agents)

    def simulator(self) -> Simulator:
        """Return a batch of environments after a reset."""
        simulator = Simulator(EnvConfig.from_keywords(**self.keywords()), self.num_envs, self.num_threads)
        simulator.reset(seeds={b: self.seed + b for b in range(self.num_envs)})
        return simulator
