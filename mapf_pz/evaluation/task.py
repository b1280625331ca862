"""A task: some episodes of one kind, by which policies are judged."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

from mapf_pz.instance import Instance, InstanceSource
from mapf_pz.instances import InstanceList


@dataclass(frozen=True)
class EvaluationTask:
    """Some episodes of one kind, numbered from 0.

    Raises `ValueError` where `keywords` or `instances` have another number of agents than `num_agents`.
    """

    name: str
    """What is evaluated, without the number of agents, such as the map's name: the first column of the results."""
    num_agents: int
    """N, the number of agents in every episode; passed to the environment."""
    keywords: dict[str, Any] = field(default_factory=dict)
    """Other keywords of `parallel_env`, such as `map` or `source` and `max_steps`. Beside `instances`, neither `map`,
    `scenario` nor `source` is allowed."""
    episodes: int = 0
    """The number of episodes each policy plays. Default, 0: one for each of the `instances`, or 256 without any."""
    seed: int = 1_000_000
    """Seed of episode 0; episode `e` has the seed `seed + e`. Training uses no seeds this large."""
    instances: tuple[Instance, ...] = ()
    """Fixed instances: episode `e` plays instance `e` modulo their number. Empty: the environment generates them."""
    best: float | None = None
    """The best known throughput, in goals per step, from which `best_ratio` is computed; None: no `best_ratio`."""

    def __post_init__(self) -> None:
        """Check that all parts agree on the number of agents, and resolve the number of episodes."""
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
        """The task's label in reports: its number of agents and its name."""
        return f"{self.num_agents} agents on {self.name}"

    def instance(self, episode: int) -> Instance | None:
        """Return the instance of an episode, or None where the environment draws it."""
        return self.instances[episode % len(self.instances)] if self.instances else None

    def env_keywords(self, episode: int) -> dict[str, Any]:
        """Return the keywords of a `parallel_env` for this episode."""
        instance = self.instance(episode)
        keywords = self.keywords | {"num_agents": self.num_agents}
        return keywords if instance is None else keywords | {"source": InstanceList([instance])}

    def with_(self, **changes: Any) -> EvaluationTask:
        """Return the same task with other fields; `None` leaves a field as it is."""
        return replace(self, **{name: value for name, value in changes.items() if value is not None})
