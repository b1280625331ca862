"""Published results of POGEMA's benchmark as episodes, and checks that they are possible on given instances.

They are packed with the instances: `mapf_pz/instances/benchmarks/README.md` names the sources.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Sequence, Set

import numpy as np

from mapf_pz._internal.arrays import Floats
from mapf_pz.evaluation.reports.bounds import least_costs, most_goals
from mapf_pz.evaluation.results import Episode
from mapf_pz.evaluation.suite import suite_label
from mapf_pz.instances import load_pogema
from mapf_pz.instances.benchmarks import pogema
from mapf_pz.instances.benchmarks.pogema import PublishedResult
from mapf_pz.instances.instance import Instance

PUBLISHED = " (published)"
"""Suffix of the names of published methods."""
TOLERATED = 0.2
"""Maximum fraction of an algorithm's episodes that may be impossible before its results are rejected."""


def published_episodes(episodes: Iterable[Episode]) -> list[Episode]:
    """Return the published episodes on the instances of some episodes, as those of policies `NAME (published)`.

    There are such episodes for the bundled suites `pogema-*`, whose version and digest must be those of the episodes.
    An episode has the number of its instance, or a negative one if its source does not state the instance; such
    episodes are returned only if `episodes` are on all instances of the task.
    """
    numbers: dict[tuple[str, str, int], set[int]] = {}
    for episode in episodes:
        numbers.setdefault((episode.suite, episode.task, episode.num_agents), set()).add(episode.number)
    return [
        published
        for (suite, task, num_agents), measured in numbers.items()
        for name in [suite.partition("/")[0]]
        if pogema.is_bundled(name) and suite == suite_label(name)
        for published in _of_task(suite, name, task, num_agents, measured)
    ]


def _of_task(suite: str, name: str, task: str, num_agents: int, measured: Set[int]) -> Iterator[Episode]:
    """Yield the published episodes of a task on the measured instances, which are given by their numbers."""
    instances = load_pogema(name, num_agents)
    shown = measured | {-1} if len(measured) == len(instances) else measured
    rows = [row for row in pogema.read_results(name, num_agents) if row.instance in shown]
    bounds = [] if name.endswith(pogema.LIFELONG) else [int(least_costs(instance).sum()) for instance in instances]
    stated = _stated(rows)
    for position, row in enumerate(rows, 1):
        number = row.instance if row.instance >= 0 else -position
        map = instances[row.instance].grid.name if row.instance >= 0 else ""
        metrics = {name: value for name, value in row.metrics.items() if name in stated[row.algorithm]}
        if bounds and row.instance >= 0 and "SoC" in metrics:
            metrics["SoC_ratio"] = metrics["SoC"] / bounds[row.instance]
        yield Episode(f"{row.algorithm}{PUBLISHED}", task, num_agents, number, metrics, map, suite=suite)


def _stated(rows: Iterable[PublishedResult]) -> dict[str, set[str]]:
    """Return the metrics of each algorithm that all its episodes have: the mean of others would be that of a part.

    Some sources state the sum of costs of solved episodes only.
    """
    stated: dict[str, set[str]] = {}
    for row in rows:
        stated.setdefault(row.algorithm, set(row.metrics)).intersection_update(row.metrics)
    return stated


def impossible_episodes(episodes: Iterable[Episode], instances: Sequence[Instance], max_steps: int) -> list[Episode]:
    """Return the episodes with results that no algorithm can reach. Those without an instance are skipped.

    A one-shot sum of costs must not be less than the sum of the shortest path lengths, each limited to `max_steps - 1`,
    the value that some algorithms count for an unsolved agent. A lifelong throughput must not exceed that of agents
    that never wait.

    Args:
        episodes: published episodes of some of the first agents of the instances.
        instances: the instances, by the episodes' numbers.
        max_steps: time limit of the episodes.
    """
    return [episode for episode, possible in _compared(episodes, instances, max_steps) if not possible]


def check_possible(episodes: Iterable[Episode], instances: Sequence[Instance], max_steps: int) -> list[Episode]:
    """Return the impossible episodes; raise `ValueError` if their fraction exceeds `TOLERATED`.

    The fraction is that of the episodes with an instance, for each algorithm and number of agents. The arguments are
    those of `impossible_episodes`.
    """
    found: list[Episode] = []
    groups: dict[tuple[str, int], list[Episode]] = defaultdict(list)
    totals: Counter[tuple[str, int]] = Counter()
    for episode, possible in _compared(episodes, instances, max_steps):
        group = episode.policy, episode.num_agents
        totals[group] += 1
        if not possible:
            found.append(episode)
            groups[group].append(episode)
    for group, members in groups.items():
        if len(members) > TOLERATED * totals[group]:
            examples = "; ".join(f"episode {member.number}, {member.instance}" for member in members[:3])
            raise ValueError(
                f"results of {group[0]} with {group[1]} agents are impossible on these instances in "
                f"{len(members)} of {totals[group]} episodes ({examples}): the instances are not those of the results"
            )
    return found


def _compared(
    episodes: Iterable[Episode], instances: Sequence[Instance], max_steps: int
) -> Iterator[tuple[Episode, bool]]:
    """Yield each episode that has an instance, and whether its result is possible."""
    bounds: dict[tuple[int, bool], Floats] = {}
    for episode in episodes:
        lifelong = "avg_throughput" in episode.metrics
        value = episode.metrics.get("avg_throughput" if lifelong else "SoC")
        if not 0 <= episode.number < len(instances) or value is None:
            continue
        instance = instances[episode.number]
        if instance.num_agents < episode.num_agents:
            continue
        key = episode.number, lifelong
        if key not in bounds:
            bounds[key] = _bounds(instance, lifelong, max_steps)
        bound = bounds[key][episode.num_agents - 1]
        yield episode, value * max_steps <= bound + 1e-6 if lifelong else value >= bound


def _bounds(instance: Instance, lifelong: bool, max_steps: int) -> Floats:
    """Return the bound (N,) on the goals reached, or the sum of costs, of the first 1, 2, ..., N agents."""
    each = most_goals(instance, max_steps) if lifelong else np.minimum(least_costs(instance), max_steps - 1)
    return each.cumsum().astype(np.float64)
