"""Differences between the policies of this package and the best published method, paired by instance."""

from __future__ import annotations

from collections.abc import Sequence
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


def paired_rows(episodes: Sequence[Episode], published: Sequence[Episode], learned: bool) -> list[dict[str, Any]]:
    """Return the mean difference of each policy to the best published method in each task.

    That is the published method with the highest mean over all instances of the task.

    Args:
        episodes: episodes of this package.
        published: published episodes. Those that do not state their instance are not compared.
        learned: whether only learned methods are compared with.
    """
    rows: list[dict[str, Any]] = []
    for metric in METRICS:
        values = _values(episodes, metric)
        references = _values([episode for episode in published if not (learned and _is_planner(episode))], metric)
        for cell in dict.fromkeys(cell for cell, _ in values):
            of_cell = [episode for episode in episodes if _cell(episode) == cell]
            best = _best(references, cell, len({episode.number for episode in of_cell}))
            if best is not None:
                of_best = [episode for episode in published if (_cell(episode), episode.policy) == (cell, best)]
                found = differences([*of_cell, *of_best], best, [metric]).rows
                rows += [_row(each, metric, best.removesuffix(PUBLISHED)) for each in found]
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
