"""Differences between the policies of this package and the best published method, paired by instance."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from mapf_pz.evaluation import Episode
from mapf_pz.evaluation.reports.intervals import difference_interval
from mapf_pz.evaluation.reports.published import PUBLISHED

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
        for (cell, policy), of_policy in values.items():
            best = _best(references, cell, len(of_policy))
            if best is not None:
                differences = [value - references[cell, best][number] for number, value in of_policy.items()]
                low, high = difference_interval(metric, differences)
                difference = {"mean": float(np.mean(differences)), "low": low, "high": high}
                rows.append(
                    {
                        "policy": policy,
                        "task": cell[0],
                        "num_agents": cell[1],
                        "best": best.removesuffix(PUBLISHED),
                        "episodes": len(differences),
                        "metrics": {metric: {name: float(f"{value:.6g}") for name, value in difference.items()}},
                    }
                )
    return rows


def _is_planner(episode: Episode) -> bool:
    return episode.policy.removesuffix(PUBLISHED) in PLANNERS


def _values(episodes: Sequence[Episode], metric: str) -> dict[tuple[Cell, str], dict[int, float]]:
    """Return a metric by task, policy and instance."""
    found: dict[tuple[Cell, str], dict[int, float]] = {}
    for episode in episodes:
        if metric in episode.metrics and episode.number >= 0:
            cell = episode.task, episode.num_agents
            found.setdefault((cell, episode.policy), {})[episode.number] = episode.metrics[metric]
    return found


def _best(references: dict[tuple[Cell, str], dict[int, float]], cell: Cell, count: int) -> str | None:
    """Return the method with the highest mean in a task, out of those with a result for all `count` instances."""
    means = {
        policy: float(np.mean(list(values.values())))
        for (other, policy), values in references.items()
        if other == cell and len(values) == count
    }
    return max(means, key=lambda policy: (means[policy], policy)) if means else None
