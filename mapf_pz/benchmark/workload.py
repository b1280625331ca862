"""The workload: what is stepped."""

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
    """Environments that agents step in with random actions, and begin anew when they are over."""

    map: str | None = None
    """A map's name or the path of a `.map` file; None draws a random map."""
    height: int = 32
    """Rows of a random map."""
    width: int = 32
    """Columns of a random map."""
    density: float = 0.2
    """Share of obstacles on a random map."""
    num_agents: int = 8
    """The number of agents."""
    num_envs: int = 64
    """Environments stepped together, where there is a batch."""
    num_threads: int = 1
    """Threads of the kernels."""
    view_size: tuple[int, int] = EnvConfig.view_size
    """(rows, columns) of each agent's view."""
    max_steps: int = EnvConfig.max_steps
    """Steps of an episode, and of a run."""
    seed: int = 0
    """Decides maps, episodes and actions."""
    new_maps: bool = False
    """Draw a new random map for every episode, instead of one for all."""
    complete: bool = False
    """Observe the cost to go and what each action is worth besides, and earn progress."""

    def keywords(self) -> dict[str, Any]:
        """Return the keywords of `parallel_env`."""
        keywords: dict[str, Any] = {"view_size": self.view_size, "max_steps": self.max_steps}
        if self.complete:
            channels = (*EnvConfig.channels, "cost_to_go")
            keywords |= {"channels": channels, "features": ("action_advantage",), "reward": "progress"}
        return keywords | {"source": self.source()}

    def source(self) -> InstanceSource:
        """Return where episodes come from; raises `ValueError` where not all agents fit."""
        if self.map is not None:
            return FixedMap(load_map(self.map), self.num_agents)
        maps = RandomObstacles(self.height, self.width, self.density, self.num_agents)
        return maps if self.new_maps else FixedMap(maps.sample(np.random.default_rng(self.seed)).grid, self.num_agents)

    def simulator(self) -> Simulator:
        """Return a batch of environments whose episodes have begun."""
        simulator = Simulator(EnvConfig.from_keywords(**self.keywords()), self.num_envs, self.num_threads)
        simulator.reset(seeds={b: self.seed + b for b in range(self.num_envs)})
        return simulator
