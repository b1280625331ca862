"""An evaluation task: episodes with the same settings, on which policies are evaluated."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

from mapf_pz.instances import InstanceList
from mapf_pz.instances.instance import Instance, InstanceSource
from mapf_pz.simulator.config import EnvConfig, check_whole
from mapf_pz.simulator.seeds import FIRST_EVALUATION_SEED


@dataclass(frozen=True)
class EvaluationTask:
    """Episodes with the same settings, numbered from 0.

    Raises `ValueError` if `num_agents`, `episodes` or `seed` is not a whole number, if `keywords` or `instances` have
    another number of agents than `num_agents`, or if there are other numbers of instances and of names.
    """

    name: str
    """Name of the task without the number of agents, such as the map's name: the first column of the results."""
    num_agents: int
    """Number of agents in every episode, which is passed to the environment."""
    keywords: dict[str, Any] = field(default_factory=dict)
    """Other keyword arguments of `parallel_env`, such as `map` or `source` and `max_steps`. With `instances`, neither
    `map`, `scenario` nor `source` is allowed."""
    episodes: int = 0
    """Number of episodes. With the default of 0, it is the number of `instances`, or 256 if there are none."""
    seed: int = FIRST_EVALUATION_SEED
    """Seed of episode 0; episode `e` has the seed `seed + e`. Training does not use these seeds."""
    instances: tuple[Instance, ...] = ()
    """Fixed instances: episode `e` uses instance `e` modulo their number. If empty, the environment generates them."""
    instance_names: tuple[str, ...] = ()
    """Names of the instances in the results, such as those of their files. Default: the names of their maps."""
    best: float | None = None
    """Best known throughput in goals per step, for the metric `best_ratio`. None: no `best_ratio`."""
    best_costs: tuple[int | None, ...] = ()
    """Best known sum of costs of each of `instances` for cardinal agents that stay at their goals, for the metric
    `best_ratio`; None: not known. Empty: none is known."""
    suite: str = ""
    """Name, version and digest of the suite that the task is a part of, such as `standard/1 0123456789abcdef`; empty if
    it is not, or if the suite has no version."""

    def __post_init__(self) -> None:
        """Check the numbers and that all parts agree on that of agents; resolve the number of episodes."""
        for name, least in (("num_agents", 1), ("episodes", 0), ("seed", 0)):
            check_whole(f"task {self.name!r}: {name}", getattr(self, name), least)
        if self.instance_names and len(self.instance_names) != len(self.instances):
            expected = f"task {self.name!r}: {len(self.instances)} instances"
            raise ValueError(f"{expected}, but {len(self.instance_names)} names of instances")
        for origin, count in self._agent_counts():
            if count != self.num_agents:
                expected = f"task {self.name!r}: num_agents={self.num_agents}"
                raise ValueError(f"{expected}, but {origin} has {count} agents")
        object.__setattr__(self, "episodes", self.episodes or len(self.instances) or 256)

    def _agent_counts(self) -> Iterator[tuple[str, int]]:
        """Yield the number of agents that each part states."""
        if "num_agents" in self.keywords:
            yield "keywords['num_agents']", self.keywords["num_agents"]
        source = self.keywords.get("source")
        if isinstance(source, InstanceSource):
            yield "keywords['source']", source.num_agents
        for number, instance in enumerate(self.instances):
            yield f"instance {number}", instance.num_agents

    @property
    def label(self) -> str:
        """Label of the task in reports: its number of agents and its name."""
        return task_label(self.name, self.num_agents)

    def instance(self, episode: int) -> Instance | None:
        """Return the instance of an episode, or None if the environment generates it."""
        return self.instances[episode % len(self.instances)] if self.instances else None

    def instance_name(self, episode: int) -> str:
        """Return the name of an episode's instance, which is empty if the environment generates it."""
        names = self.instance_names or [instance.grid.name for instance in self.instances]
        return names[episode % len(names)] if names else ""

    def plan_name(self, episode: int) -> str:
        """Return the name by which the plan of an episode is found.

        It is that of its instance, and also the number of the episode if other episodes have an instance of that name.
        """
        name = self.instance_name(episode)
        unique = sum(self.instance_name(other) == name for other in range(self.episodes)) == 1
        return name if unique else f"{name}-{episode}"

    def best_result(self, episode: int, config: EnvConfig) -> float | None:
        """Return the best known throughput or sum of costs of an episode in an environment; None: not known."""
        if config.on_target == "restart":
            return self.best
        if config.on_target != "nothing" or config.action_model != "cardinal" or not self.best_costs:
            return None
        return self.best_costs[episode % len(self.best_costs)]

    def env_keywords(self, episode: int) -> dict[str, Any]:
        """Return the keyword arguments of `parallel_env` for an episode."""
        instance = self.instance(episode)
        keywords = self.keywords | {"num_agents": self.num_agents}
        return keywords if instance is None else keywords | {"source": InstanceList([instance])}

    def with_(self, **changes: Any) -> EvaluationTask:
        """Return a copy of the task with changed fields; fields that are `None` are not changed."""
        return replace(self, **{name: value for name, value in changes.items() if value is not None})

    def only(self, episode: int) -> EvaluationTask:
        """Return the task that consists of one episode."""
        seed = self.seed + episode
        if not self.instances:
            return replace(self, episodes=1, seed=seed)
        first = episode % len(self.instances)
        at = slice(first, first + 1)
        parts = {name: getattr(self, name)[at] for name in ("instances", "instance_names", "best_costs")}
        return replace(self, episodes=1, seed=seed, **parts)


def task_label(name: str, num_agents: int) -> str:
    """Return the label of a task with this name."""
    return f"{num_agents} agents on {name}"
