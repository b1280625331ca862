"""What a guidance graph is optimized for."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

from mapf_pz._internal.config import checked
from mapf_pz.evaluation.policies import check_observed
from mapf_pz.guidance import GuidanceGraph
from mapf_pz.instances.instance import Grid
from mapf_pz.planners.named import planner_class
from mapf_pz.simulator.config import EnvConfig
from mapf_pz.simulator.keywords import EnvKeywords
from mapf_pz.simulator.saved_config import SavedKeywords
from mapf_pz.simulator.source import make_source

LIFELONG = EnvKeywords({"on_target": "restart", "max_steps": 1000})
"""The protocol of Zhang et al., *Guidance Graph Optimization for Lifelong MAPF*, IJCAI 2024."""


@checked
@dataclass(frozen=True, kw_only=True)
class GuidanceTask:
    """A planner or policy, and the episodes in which it uses the guidance graph.

    The score of an episode, which is maximized, is the throughput in goals per step with `on_target="restart"`;
    otherwise it is minus the sum of costs per agent, where agents that do not arrive cost twice the maximum number of
    steps.

    Raises `ValueError` if the episodes have different maps, for another reward, and for observations of a planner.
    """

    env: SavedKeywords = LIFELONG
    """The environment. A policy determines fields that are absent, such as the action model. The `edge_weights` compete
    with the graphs that are found."""
    planner: str = "pibt"
    """A planner or policy by name, as in `mapf-pz evaluate`."""
    trust_remote_code: bool = False
    """Load a policy whose configuration names code outside this package (`package.module:name`), and run that code."""

    def __post_init__(self) -> None:
        """Check that all episodes have one map, and that no field is without effect."""
        check_observed(self.planner, self.env.keywords)
        if "reward" in self.env.keywords:
            raise ValueError("reward: expected that of the environment, since the score does not depend on it")
        if make_source(self.config).grid is None:
            raise ValueError("a guidance graph belongs to one map: expected episodes that share one")

    @cached_property
    def config(self) -> EnvConfig:
        """The environment of a planner."""
        return self.env.config()

    @cached_property
    def grid(self) -> Grid:
        """The map."""
        grid = make_source(self.config).grid
        assert grid is not None
        return grid

    @property
    def is_lifelong(self) -> bool:
        """Whether the score is the throughput."""
        return self.config.on_target == "restart"

    @property
    def is_planner(self) -> bool:
        """Whether a planner acts, which reads the state instead of observations."""
        return planner_class(self.planner) is not None

    def with_graph(self, graph: GuidanceGraph, num_steps: int | None = None) -> dict[str, Any]:
        """Return the environment's keywords with this guidance graph, and another maximum number of steps if given."""
        limit = {} if num_steps is None else {"max_steps": num_steps}
        return self.env.keywords | {"edge_weights": graph} | limit
