"""Published results of POGEMA's benchmark, and checks that they are possible on given instances.

Source: github.com/Cognitive-AI-Systems/pogema-benchmark, one row per episode in `SET.results*.csv`.
"""

from __future__ import annotations

import csv
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mapf_pz._internal.arrays import Floats
from mapf_pz._internal.text import read_text
from mapf_pz.errors import FormatError
from mapf_pz.evaluation.reports.bounds import least_costs, most_goals
from mapf_pz.instances.instance import Instance

COLUMNS = ("kind", "algorithm", "num_agents", "map_name", "seed")
METRICS = ("CSR", "ISR", "SoC", "makespan", "avg_throughput")
TOLERATED = 0.2
"""Maximum fraction of an algorithm's episodes that may be impossible before its results are rejected."""

InstanceKey = tuple[str, str]
"""Map name and seed, which identify an instance of the benchmark."""


@dataclass(frozen=True)
class PublishedEpisode:
    """One row of a file of published results."""

    lifelong: bool
    """True for `lmapf`, False for `mapf`."""
    algorithm: str
    """The algorithm's name."""
    num_agents: int
    """Number of agents."""
    instance: InstanceKey
    """The instance; the seed is empty if the file has none."""
    metrics: Mapping[str, float]
    """Metrics by name, out of `METRICS`."""

    def __str__(self) -> str:
        """Return a description that identifies the episode."""
        map_name, seed = self.instance
        return f"{self.algorithm}, {self.num_agents} agents on {map_name}, seed {seed}"


def load_published(file: str | Path) -> list[PublishedEpisode]:
    """Read a file of published results.

    Raises:
        FileNotFoundError: the file does not exist.
        FormatError: a column is missing, or a value is not a number.
    """
    rows = csv.DictReader(read_text(file).splitlines())
    missing = [name for name in (*COLUMNS, *METRICS) if name not in (rows.fieldnames or ())]
    if missing:
        raise FormatError(file, f"expected the columns {', '.join(missing)}", 1)
    try:
        return [_episode(row) for row in rows]
    except (ValueError, TypeError) as error:
        raise FormatError(file, f"expected an episode: {error}", rows.line_num) from None


def _episode(row: Mapping[str, str]) -> PublishedEpisode:
    metrics = {name: float(row[name]) for name in METRICS if row[name]}
    key = row["map_name"], row["seed"]
    return PublishedEpisode(row["kind"] == "lmapf", row["algorithm"], int(row["num_agents"]), key, metrics)


def impossible_episodes(
    episodes: Iterable[PublishedEpisode], instances: Mapping[InstanceKey, Instance], max_steps: int
) -> list[PublishedEpisode]:
    """Return the episodes with results that no algorithm can reach. Episodes without a matching instance are skipped.

    A one-shot sum of costs must not be less than the sum of the shortest path lengths, each limited to `max_steps - 1`,
    the value that some algorithms count for an unsolved agent. A lifelong throughput must not exceed that of agents
    that never wait.

    Args:
        episodes: published results, for the first agents of an instance.
        instances: the instances by map name and seed.
        max_steps: time limit of the episodes.
    """
    return [episode for episode, possible in _compared(episodes, instances, max_steps) if not possible]


def check_possible(
    episodes: Iterable[PublishedEpisode], instances: Mapping[InstanceKey, Instance], max_steps: int
) -> list[PublishedEpisode]:
    """Return the impossible episodes; raise `ValueError` if their fraction exceeds `TOLERATED`.

    The fraction is that of the episodes with a matching instance, for each algorithm and number of agents. The
    arguments are those of `impossible_episodes`.
    """
    found: list[PublishedEpisode] = []
    groups: dict[tuple[bool, str, int], list[PublishedEpisode]] = defaultdict(list)
    totals: Counter[tuple[bool, str, int]] = Counter()
    for episode, possible in _compared(episodes, instances, max_steps):
        group = episode.lifelong, episode.algorithm, episode.num_agents
        totals[group] += 1
        if not possible:
            found.append(episode)
            groups[group].append(episode)
    for group, members in groups.items():
        if len(members) > TOLERATED * totals[group]:
            examples = "; ".join(map(str, members[:3]))
            raise ValueError(
                f"published results of {group[1]} with {group[2]} agents are impossible on these instances in "
                f"{len(members)} of {totals[group]} episodes ({examples}): the instances are not those of the results"
            )
    return found


def _compared(
    episodes: Iterable[PublishedEpisode], instances: Mapping[InstanceKey, Instance], max_steps: int
) -> Iterator[tuple[PublishedEpisode, bool]]:
    """Yield each episode that has a matching instance, and whether its result is possible."""
    bounds: dict[tuple[InstanceKey, bool], Floats] = {}
    for episode in episodes:
        instance, name = instances.get(episode.instance), "avg_throughput" if episode.lifelong else "SoC"
        if instance is None or instance.num_agents < episode.num_agents or name not in episode.metrics:
            continue
        key = episode.instance, episode.lifelong
        if key not in bounds:
            bounds[key] = _bounds(instance, episode.lifelong, max_steps)
        bound, value = bounds[key][episode.num_agents - 1], episode.metrics[name]
        yield episode, value * max_steps <= bound + 1e-6 if episode.lifelong else value >= bound


def _bounds(instance: Instance, lifelong: bool, max_steps: int) -> Floats:
    """Return the bound (N,) on the goals reached, or the sum of costs, of the first 1, 2, ..., N agents."""
    each = most_goals(instance, max_steps) if lifelong else np.minimum(least_costs(instance), max_steps - 1)
    return each.cumsum().astype(np.float64)
