"""Differences between the policies of this package and the best published method, paired by instance.

Results files have the compared metrics of each episode (`values_of`), so that new published results need no episodes.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from mapf_pz.evaluation import Episode
from mapf_pz.evaluation.reports.published import PUBLISHED
from mapf_pz.evaluation.reports.report import Summary, differences

METRICS = ("CSR", "avg_throughput")
"""The metrics that are compared; more is better."""
PLANNERS = ("LaCAM", "LaCAM (10 s)", "RHCR")
"""The published methods that plan with the whole state; all others are learned."""

Cell = tuple[str, int]
"""A task's name and its number of agents."""


def values_of(episodes: Sequence[Episode]) -> list[dict[str, Any]]:
    """Return the compared metrics of each episode, in the order of the instances, for each policy and task."""
    found: dict[tuple[str, Cell, str], dict[int, float]] = {}
    for metric in METRICS:
        for (cell, policy), values in _values(episodes, metric).items():
            found[policy, cell, metric] = values
    return [
        {
            "policy": policy,
            "task": task,
            "num_agents": num_agents,
            metric: [_number(values[n]) for n in range(len(values))],
        }
        for (policy, (task, num_agents), metric), values in found.items()
    ]


def _number(value: float) -> float:
    """Return a value rounded to six digits, a whole one as an integer."""
    return int(value) if value == int(value) else float(f"{value:.6g}")


def episodes_of(rows: Iterable[Mapping[str, Any]], suite: str) -> list[Episode]:
    """Return the episodes of `values_of` in a suite, with the compared metrics."""
    return [
        Episode(row["policy"], row["task"], row["num_agents"], number, {metric: value}, suite=suite)
        for row in rows
        for metric in METRICS
        for number, value in enumerate(row.get(metric, ()))
    ]


def best_published(
    published: Sequence[Episode], counts: Mapping[Cell, int], learned: bool
) -> dict[tuple[Cell, str], str]:
    """Return the published method with the highest mean over all instances of each task, by task and metric.

    Args:
        published: published episodes. Those that do not state their instance are left out.
        counts: the number of instances of each task.
        learned: whether only learned methods are compared with.
    """
    found: dict[tuple[Cell, str], str] = {}
    for metric in METRICS:
        references = _values([episode for episode in published if not (learned and _is_planner(episode))], metric)
        for cell, count in counts.items():
            best = _best(references, cell, count)
            if best is not None:
                found[cell, metric] = best
    return found


def paired_rows(episodes: Sequence[Episode], published: Sequence[Episode], learned: bool) -> list[dict[str, Any]]:
    """Return the mean difference of each policy to the best published method in each task: see `best_published`.

    Args:
        episodes: episodes of this package.
        published: published episodes.
        learned: whether only learned methods are compared with.
    """
    numbers: dict[Cell, set[int]] = {}
    for episode in episodes:
        numbers.setdefault(_cell(episode), set()).add(episode.number)
    rows: list[dict[str, Any]] = []
    best = best_published(published, {cell: len(found) for cell, found in numbers.items()}, learned)
    for (cell, metric), name in best.items():
        of_cell = [episode for episode in episodes if _cell(episode) == cell and metric in episode.metrics]
        of_best = [episode for episode in published if (_cell(episode), episode.policy) == (cell, name)]
        if of_cell:
            found = differences([*of_cell, *of_best], name, [metric]).rows
            rows += [_row(each, metric, name.removesuffix(PUBLISHED)) for each in found]
    return rows


def _row(difference: Summary, metric: str, best: str) -> dict[str, Any]:
    """Return the mean difference of a policy and its 95 % interval, rounded to six digits."""
    estimate = asdict(difference.estimates[metric])
    return {
        "policy": difference.policy,
        "task": difference.task,
        "num_agents": difference.num_agents,
        "best": best,
        "episodes": difference.episodes,
        "metrics": {metric: {name: float(f"{value:.6g}") for name, value in estimate.items()}},
    }


def _cell(episode: Episode) -> Cell:
    return episode.task, episode.num_agents


def _is_planner(episode: Episode) -> bool:
    return episode.policy.removesuffix(PUBLISHED) in PLANNERS


def _values(episodes: Sequence[Episode], metric: str) -> dict[tuple[Cell, str], dict[int, float]]:
    """Return a metric by task, policy and instance."""
    found: dict[tuple[Cell, str], dict[int, float]] = {}
    for episode in episodes:
        if metric in episode.metrics and episode.number >= 0:
            found.setdefault((_cell(episode), episode.policy), {})[episode.number] = episode.metrics[metric]
    return found


def _best(references: dict[tuple[Cell, str], dict[int, float]], cell: Cell, count: int) -> str | None:
    """Return the method with the highest mean in a task, out of those with a result for all `count` instances."""
    means = {
        policy: float(np.mean(list(values.values())))
        for (other, policy), values in references.items()
        if other == cell and len(values) == count
    }
    return max(means, key=lambda policy: (means[policy], policy)) if means else None
