"""The settings of a dataset of demonstrations."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated

from pydantic import Field

from mapf_pz._internal.config import Count, Items, Natural, checked
from mapf_pz.guidance import GuidanceGraph
from mapf_pz.guidance.library import random_share
from mapf_pz.instances.instance import InstanceSource
from mapf_pz.instances.mixture import MapMixture
from mapf_pz.planners import Planner, planner_of
from mapf_pz.planners.named import import_code
from mapf_pz.simulator.config import EnvConfig
from mapf_pz.simulator.seeds import FIRST_EVALUATION_SEED
from mapf_pz.simulator.source import make_source

RULES = ("action_model", "collision_system", "on_target", "max_steps", "edge_weights")
"""The keywords of the environment that are stored with the demonstrations."""


@checked
@dataclass(frozen=True)
class DatasetConfig:
    """The planner and the episodes of a dataset. Raises `ValueError` for invalid values."""

    planner: str = "lacam:clock=work"
    """Name of the planner, with options as in `lacam:time_limit=5,clock=work`. Without `clock=work`, time limits are in
    seconds of CPU time."""
    env: EnvConfig = field(default_factory=EnvConfig)
    """The environment; its observations and its reward are ignored. Without a map, scenario or source, episodes use the
    maps of the mixture."""
    mixture: MapMixture = field(default_factory=MapMixture)
    """The maps, if there is no map, scenario or source."""
    num_agents: Annotated[Items[Count], Field(min_length=1)] | None = None
    """Number of agents, or several numbers. Default: all agents of the scenario or source, otherwise 4."""
    episodes: Count = 1000
    """Number of episodes for each number of agents."""
    shard_size: Count = 100
    """Number of episodes in a file, which one process makes."""
    solved_only: bool = True
    """Whether episodes that end while an agent is not at its goal are omitted; does not apply to lifelong episodes."""
    seed: Natural = 0
    """Random seed. Episode k of the dataset has the seed `seed + k`, which must be below 1,000,000, where the seeds of
    evaluations start."""
    license: str = "MIT"
    """License of the dataset, for its card."""

    def __post_init__(self) -> None:
        """Check the planner, the seeds, and the guidance graph."""
        import_code(self.planner)
        planner_of(self.planner)
        if self.seed + self.episodes > FIRST_EVALUATION_SEED:
            most = FIRST_EVALUATION_SEED - self.episodes
            raise ValueError(f"seed={self.seed}: expected at most {most}, since evaluations use the following seeds")
        weights = self.env.edge_weights
        if isinstance(weights, GuidanceGraph) or random_share(weights):
            raise ValueError("edge_weights: expected a name or a file, since guidance graphs are not stored")
        if self.env.delays is not None:
            raise ValueError("delays: expected none, since demonstrations do not have them")

    @cached_property
    def agent_counts(self) -> tuple[int, ...]:
        """The numbers of agents; reads the file of the scenario if nothing else determines them."""
        return self.num_agents or (self.source(self.env.num_agents).num_agents,)

    def source(self, num_agents: int | None) -> InstanceSource:
        """Return the source of episodes with this number of agents; raises as `make_source` and `MapMixture.source`."""
        return make_source(replace(self.env, num_agents=num_agents), self.mixture.source)

    def env_config(self, num_agents: int) -> EnvConfig:
        """Return the environment with this number of agents, and with observations that cost little."""
        names = (*RULES, "initial_heading", "distance_bytes")
        kept = {name: getattr(self.env, name) for name in names}
        return EnvConfig(**kept, **Planner.env_kwargs, source=self.source(num_agents))
