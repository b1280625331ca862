"""Summaries of evaluated episodes, and the table that shows them."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.table import Table

Episodes = Sequence[dict[str, float]]
SHOWN = ("CSR", "ISR", "SoC_ratio", "makespan", "ep_length", "avg_throughput", "runtime")


def interval(values: Sequence[float], seed: int = 0, draws: int = 2000) -> tuple[float, float]:
    """Return the 95 % bootstrap interval of the mean of `values` (Efron, 1979)."""
    array = np.asarray(values)
    means = np.random.default_rng(seed).choice(array, (draws, len(array))).mean(axis=1)
    low, high = np.quantile(means, (0.025, 0.975))
    return float(low), float(high)


def results_table(results: dict[str, Episodes]) -> Table:
    """Return a table: a row for each trial, means with their 95 % intervals."""
    keys = [key for key in SHOWN if any(key in episodes[0] for episodes in results.values())]
    table = Table("trial", "episodes", *keys, title="mean [95 % interval]")
    for name, episodes in results.items():
        table.add_row(name, str(len(episodes)), *[_cell(episodes, key) for key in keys])
    return table


def write_episodes(results: dict[str, Episodes], file: Path) -> None:
    """Write one row an episode as CSV."""
    keys = sorted({key for episodes in results.values() for episode in episodes for key in episode})
    with file.open("w", newline="") as out:
        writer = csv.DictWriter(out, ["trial", "episode", *keys])
        writer.writeheader()
        for name, episodes in results.items():
            for number, episode in enumerate(episodes):
                writer.writerow({"trial": name, "episode": number} | episode)


def _cell(episodes: Episodes, key: str) -> str:
    if key not in episodes[0]:
        return ""
    values = [episode[key] for episode in episodes]
    low, high = interval(values)
    return f"{np.mean(values):.3g} [{low:.3g}, {high:.3g}]"
