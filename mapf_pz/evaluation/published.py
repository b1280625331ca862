"""Published results of POGEMA's benchmark, and whether they are possible on the instances at hand.

Source: github.com/Cognitive-AI-Systems/pogema-benchmark, one row per episode in `SET.results*.csv`.
"""

from __future__ import annotations

import csv
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mapf_pz.arrays import Floats
from mapf_pz.errors import FormatError
from mapf_pz.evaluation.bounds import least_costs, most_goals
from mapf_pz.instance import Instance
from mapf_pz.io.text import read_text

COLUMNS = ("kind", "algorithm", "num_agents", "map_name", "seed")
METRICS = ("CSR", "ISR", "SoC", "makespan", "avg_throughput")
TOLERATED = 0.2
"""The share of an algorithm's episodes that may be impossible before its results are refused."""

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
    """N."""
    instance: InstanceKey
    """Which instance; the seed is empty where the file has none."""
    metrics: Mapping[str, float]
    """By name, those of `METRICS` that the row has."""

    def __str__(self) -> str:
        """Return what identifies the episode."""
        map_name, seed = self.instance
        return f"{self.algorithm}, {self.num_agents} agents on {map_name}, seed {seed}"


def load_published(file: str | Path) -> list[PublishedEpisode]:
    """Read a file of published results.

    Raises:
        FileNotFoundError: There is no such file.
        FormatError: A column is missing, or a value is no number.
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
    """Return the episodes whose results no algorithm can reach; those without an instance of enough agents are skipped.

    A one-shot sum of costs must not be below the sum of the shortest path lengths, in which an agent counts at most
    `max_steps - 1`: some algorithms count that for an unsolved agent. A lifelong throughput must not be above that of
    agents that never wait.

    Args:
        episodes: published results; their agents are the first of an instance.
        instances: by map name and seed.
        max_steps: the episodes' limit.
    """
    bounds: dict[tuple[InstanceKey, bool], Floats] = {}
    found: list[PublishedEpisode] = []
    for episode in episodes:
        instance, name = instances.get(episode.instance), "avg_throughput" if episode.lifelong else "SoC"
        if instance is None or instance.num_agents < episode.num_agents or name not in episode.metrics:
            continue
        key = episode.instance, episode.lifelong
        if key not in bounds:
            bounds[key] = _bounds(instance, episode.lifelong, max_steps)
        bound, value = bounds[key][episode.num_agents - 1], episode.metrics[name]
        if value * max_steps > bound + 1e-6 if episode.lifelong else value < bound:
            found.append(episode)
    return found


def check_possible(
    episodes: Sequence[PublishedEpisode], instances: Mapping[InstanceKey, Instance], max_steps: int
) -> list[PublishedEpisode]:
    """Return the impossible episodes; raise `ValueError` where they are more than `TOLERATED` of an algorithm's.

    The share is that among the episodes of one algorithm with one number of agents. Arguments are those of
    `impossible_episodes`.
    """
    found = impossible_episodes(episodes, instances, max_steps)
    counts: dict[tuple[bool, str, int], list[PublishedEpisode]] = defaultdict(list)
    for episode in found:
        counts[episode.lifelong, episode.algorithm, episode.num_agents].append(episode)
    for group, members in counts.items():
        total = sum((episode.lifelong, episode.algorithm, episode.num_agents) == group for episode in episodes)
        if len(members) > TOLERATED * total:
            named = "; ".join(map(str, members[:3]))
            raise ValueError(
                f"published results of {group[1]} with {group[2]} agents are impossible on these instances in "
                f"{len(members)} of {total} episodes ({named}): the instances are not those of the results"
            )
    return found


def _bounds(instance: Instance, lifelong: bool, max_steps: int) -> Floats:
    """Return the bound (N,) on what the first 1, 2, ..., N agents reach together: goals, or the sum of costs."""
    each = most_goals(instance, max_steps) if lifelong else np.minimum(least_costs(instance), max_steps - 1)
    return each.cumsum().astype(np.float64)
