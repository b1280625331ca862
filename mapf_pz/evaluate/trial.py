"""A trial: some episodes of one kind, by which policies are judged."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

from mapf_pz.instances import InstanceList
from mapf_pz.types import Instance


@dataclass(frozen=True)
class Trial:
    """Some episodes of one kind, numbered from 0."""

    family: str
    """What the trial is about, all but the number of agents."""
    num_agents: int
    """N."""
    keywords: dict[str, Any] = field(default_factory=dict)
    """Keywords of `parallel_env`, without those that say where episodes come from if there are `instances`."""
    episodes: int = 256
    """How many."""
    seed: int = 1_000_000
    """Of episode 0; the others follow by ones. Training has no seeds this large."""
    instances: tuple[Instance, ...] = ()
    """Episode `e` is instance `e` modulo their number; none: the environment draws episodes."""
    best: float | None = None
    """The best throughput known, for `best_ratio`."""

    @property
    def name(self) -> str:
        """Return what the trial is called."""
        return f"{self.num_agents} agents on {self.family}"

    def instance(self, episode: int) -> Instance | None:
        """Return the instance of an episode, or None where the environment draws it."""
        return self.instances[episode % len(self.instances)] if self.instances else None

    def env_keywords(self, episode: int) -> dict[str, Any]:
        """Return the keywords of a `parallel_env` for this episode."""
        instance = self.instance(episode)
        return self.keywords if instance is None else self.keywords | {"source": InstanceList([instance])}

    def but(self, **changes: Any) -> Trial:
        """Return the same trial with other fields; `None` leaves a field as it is."""
        return replace(self, **{name: value for name, value in changes.items() if value is not None})
