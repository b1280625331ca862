"""Summaries of evaluated episodes: means with intervals, as a table for the terminal and in Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from rich.markup import escape
from rich.table import Table

from mapf_pz.evaluation.results import METRICS, Episode

SHOWN = tuple(name for name in METRICS if name not in ("SoC", "ep_length", "runtime"))
"""The metrics in tables; the others are only in the file of episodes."""

Group = tuple[str, int, str]
"""A task's name, its number of agents, and a policy."""


def interval(values: Sequence[float], seed: int = 0, resamples: int = 2000) -> tuple[float, float]:
    """Return the 95 % bootstrap interval of the mean of `values` (Efron, 1979)."""
    array = np.asarray(values)
    means = np.random.default_rng(seed).choice(array, (resamples, len(array))).mean(axis=1)
    low, high = np.quantile(means, (0.025, 0.975))
    return float(low), float(high)


def grouped(episodes: Iterable[Episode]) -> dict[Group, dict[str, list[float]]]:
    """Return the values of each metric for each task and policy, in the order of the episodes."""
    groups: dict[Group, dict[str, list[float]]] = {}
    for episode in episodes:
        values = groups.setdefault((episode.task, episode.num_agents, episode.policy), {})
        for name, value in episode.metrics.items():
            values.setdefault(name, []).append(value)
    return groups


def rows(episodes: Iterable[Episode]) -> list[list[str]]:
    """Return the table: its header, and a row for each task and policy, with means and their 95 % intervals."""
    groups = grouped(episodes)
    shown = [name for name in SHOWN if any(_is_shown(name, values) for values in groups.values())]
    table = [["task", "agents", "policy", "episodes", *shown]]
    for (task_name, num_agents, policy), values in groups.items():
        count = max(map(len, values.values()))
        table.append([task_name, str(num_agents), policy, str(count), *(_cell(values.get(name)) for name in shown)])
    return table


def exhausted(episodes: Iterable[Episode]) -> list[str]:
    """Return a warning for each task and policy with agents that reached the end of their goal sequences."""
    return [
        f"{policy}, {num_agents} agents on {task_name}: agents reached the end of their goal sequence and started it "
        f"over in {np.count_nonzero(values['exhausted_agents'])} episodes; their throughput is not comparable"
        for (task_name, num_agents, policy), values in grouped(episodes).items()
        if any(values.get("exhausted_agents", ()))
    ]


def terminal_table(episodes: Iterable[Episode]) -> Table:
    """Return the table for a terminal."""
    header, *body = rows(episodes)
    table = Table(*header, title="mean [95 % interval]")
    for row in body:
        table.add_row(*map(escape, row))
    return table


def markdown_table(episodes: Iterable[Episode]) -> str:
    """Return the table in Markdown."""
    header, *body = rows(episodes)
    lines = [header, ["---"] * len(header), *body]
    return "".join(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in line)} |\n" for line in lines)


def _is_shown(name: str, values: dict[str, list[float]]) -> bool:
    """Return whether a metric is shown: `exhausted_agents` only if it is not 0."""
    return any(values[name]) if name == "exhausted_agents" and name in values else name in values


def _cell(values: Sequence[float] | None) -> str:
    if values is None:
        return ""
    mean = f"{np.mean(values):.3g}"
    low, high = (f"{end:.3g}" for end in interval(values))
    return mean if low == high else f"{mean} [{low}, {high}]"
