"""The table of this package beside the published methods, of several suites at their largest numbers of agents."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from experiments.pages import spread
from experiments.tables.paired import PLANNERS
from mapf_pz.evaluation.policies import SHIELD_SUFFIX


def field_table(suites: Sequence[Mapping[str, Any]], metric: str) -> list[list[str]]:
    """Return a table with a column for each suite: trained policies of this package, and the best of other methods.

    The policies are the same in all columns: the one with the highest mean over them, and the one of those that act
    without the safety layer. Their cells have the mean over training seeds, in brackets the smallest and the largest.
    Of the published learned policies, the published planners and the planners of this package, each column has the best
    one, with its name.

    Args:
        suites: the results of each suite.
        metric: the metric; more is better.
    """
    columns = [_column(results, metric) for results in suites]
    header = ["", *(f"{column['task']}, {column['num_agents']} agents" for column in columns)]
    trained = [column["trained"] for column in columns]
    common = sorted(set.intersection(*(set(found) for found in trained)))
    unshielded = [name for name in common if SHIELD_SUFFIX not in name]
    best = [
        max(names, key=lambda name: sum(np.mean(found[name]) for found in trained))
        for names in (common, unshielded)
        if names
    ]
    rows = [
        [f"**{_label(policy)}**", *(f"**{spread(found[policy], 3, 'g')}**" for found in trained)]
        for policy in dict.fromkeys(best)
    ]
    kinds = ("published learned policy", "published planner", "planner of this package")
    return [header, *rows, *([f"best {kind}", *(_best(column[kind]) for column in columns)] for kind in kinds)]


def _label(policy: str) -> str:
    """Return what a trained policy is, and its name."""
    return f"trained policy{' with safety layer' if SHIELD_SUFFIX in policy else ''} (`{policy}`)"


def _column(results: Mapping[str, Any], metric: str) -> dict[str, Any]:
    """Return the methods of each kind in a suite's task with the most agents, with their means."""
    num_agents = max(row["num_agents"] for row in results["rows"])
    policies = results["identities"]["policies"]
    own, published = (_means(results[part], num_agents, metric) for part in ("rows", "published"))
    return {
        "task": results["rows"][0]["task"].removeprefix("POGEMA ").removesuffix(", lifelong"),
        "num_agents": num_agents,
        "trained": {
            name: seed_means(results, name, num_agents, metric) for name in own if policies[name]["policy"] == "trained"
        },
        "planner of this package": {name: mean for name, mean in own.items() if policies[name]["policy"] != "trained"},
        "published learned policy": {name: mean for name, mean in published.items() if name not in PLANNERS},
        "published planner": {name: mean for name, mean in published.items() if name in PLANNERS},
    }


def seed_means(results: Mapping[str, Any], policy: str, num_agents: int, metric: str) -> list[float]:
    """Return the mean of a policy in the task with this number of agents, and those of its other training seeds."""
    key = (policy, str(num_agents), metric)
    others = [row for row in results["seeds"] if (row["policy"], row["num_agents"], row["metric"]) == key]
    return [_means(results["rows"], num_agents, metric)[policy], *(float(row["mean"]) for row in others)]


def _means(rows: Iterable[Mapping[str, Any]], num_agents: int, metric: str) -> dict[str, float]:
    return {
        row["policy"]: row["metrics"][metric]["mean"]
        for row in rows
        if row["num_agents"] == num_agents and metric in row["metrics"]
    }


def _best(means: Mapping[str, float]) -> str:
    """Return the highest mean and the method's name; empty if there is none."""
    if not means:
        return ""
    name = max(means, key=lambda name: (means[name], name))
    return f"{means[name]:.3g} (`{name}`)"
