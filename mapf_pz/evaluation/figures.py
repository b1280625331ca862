"""Figures of evaluated episodes: success, throughput and time by the number of agents."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mapf_pz.evaluation.report import grouped, interval
from mapf_pz.evaluation.results import Episode
from mapf_pz.io.atomic import replacing

LABELS = {
    "CSR": "all agents at their goals (CSR)",
    "ISR": "agents at their goals (ISR)",
    "SoC_ratio": "sum of costs / lower bound",
    "avg_throughput": "goals reached per step",
    "step_ms": "milliseconds per step",
}
"""The metrics to plot, if episodes have them."""

Points = dict[int, list[float]]
"""The values of a metric, by the number of agents."""


def draw_figures(episodes: Iterable[Episode], folder: Path) -> list[Path]:
    """Save a figure of each task with several numbers of agents, and return the files."""
    by_task: dict[str, dict[str, dict[str, Points]]] = {}
    for (task_name, num_agents, policy), values in grouped(episodes).items():
        for metric in values:
            lines = by_task.setdefault(task_name, {}).setdefault(metric, {})
            lines.setdefault(policy, {})[num_agents] = values[metric]
    return list(_draw(by_task, folder))


def _draw(by_task: dict[str, dict[str, dict[str, Points]]], folder: Path) -> Iterator[Path]:
    for task_name, metrics in by_task.items():
        shown = [name for name in LABELS if name in metrics]
        if not shown or max(len(points) for points in metrics[shown[0]].values()) < 2:
            continue
        figure = Figure(figsize=(4.2 * len(shown), 3.6), layout="constrained")
        for panel, metric in zip(figure.subplots(1, len(shown), squeeze=False)[0], shown, strict=True):
            _draw_panel(panel, metric, metrics[metric])
        figure.axes[0].legend(fontsize=8)
        figure.suptitle(_escaped(task_name))
        name = "".join(char if char.isalnum() else "-" for char in task_name)
        file = folder / f"{name}.png"
        with replacing(file) as temporary:
            figure.savefig(temporary, dpi=110)
        yield file


def _escaped(name: str) -> str:
    """Escape text for matplotlib, which shows text between two `$` as a formula."""
    return name.replace("$", r"\$")


def _draw_panel(panel: Axes, metric: str, lines: dict[str, Points]) -> None:
    """Plot the means of a metric with their 95 % intervals, a line for each policy."""
    for policy, points in lines.items():
        agents = sorted(points)
        ends = np.array([interval(points[count]) for count in agents])
        means = [float(np.mean(points[count])) for count in agents]
        panel.plot(agents, means, marker="o", markersize=3, label=_escaped(policy))
        panel.fill_between(agents, ends[:, 0], ends[:, 1], alpha=0.2)
    panel.set(xlabel="agents", ylabel=LABELS[metric])
    if metric == "step_ms":
        panel.set_yscale("log")
    elif metric != "SoC_ratio":
        panel.set_ylim(bottom=0)
