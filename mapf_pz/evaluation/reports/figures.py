"""Figures of evaluated episodes: success, throughput and time by the number of agents."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import count
from pathlib import Path
from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mapf_pz._internal.atomic import replacing
from mapf_pz._internal.printable import printable
from mapf_pz.evaluation.reports.intervals import interval
from mapf_pz.evaluation.reports.published import PublishedEpisode
from mapf_pz.evaluation.reports.report import SOLVED, grouped
from mapf_pz.evaluation.results import Episode

FigureFormat = Literal["png", "pdf", "svg"]
LABELS = {
    "CSR": "all agents at their goals (CSR)",
    "ISR": "agents at their goals (ISR)",
    f"SoC_ratio{SOLVED}": "sum of costs / lower bound (solved)",
    "avg_throughput": "goals reached per step",
    "step_ms": "milliseconds per step",
}
"""The metrics to plot, if episodes have them."""

MARKERS = "sv^D<>pPXhd*"
"""Markers of published methods, which have shades of gray."""

Points = dict[int, list[float]]
"""The values of a metric, by the number of agents."""


def draw_figures(
    episodes: Iterable[Episode],
    folder: Path,
    format: FigureFormat = "png",
    published: Sequence[PublishedEpisode] = (),
) -> list[Path]:
    """Save a figure of each task with several numbers of agents, and return the files.

    Args:
        episodes: the episodes.
        folder: the folder of the files, which are named by the tasks; it is created if it does not exist.
        format: the format of the files; `pdf` and `svg` are vector graphics.
        published: published results of the same instances, which are drawn as dashed lines.
    """
    folder.mkdir(parents=True, exist_ok=True)
    by_task: dict[str, dict[str, dict[str, Points]]] = {}
    for (task_name, num_agents, policy), values in grouped(episodes).items():
        for metric in values:
            lines = by_task.setdefault(task_name, {}).setdefault(metric, {})
            lines.setdefault(policy, {})[num_agents] = values[metric]
    return list(_draw(by_task, folder, format, published))


def _draw(
    by_task: dict[str, dict[str, dict[str, Points]]],
    folder: Path,
    format: FigureFormat,
    published: Sequence[PublishedEpisode],
) -> Iterator[Path]:
    names = _file_names(by_task)
    for task_name, metrics in by_task.items():
        shown = [name for name in LABELS if name in metrics]
        if not shown or max(len(points) for points in metrics[shown[0]].values()) < 2:
            continue
        figure = Figure(figsize=(4.2 * len(shown), 4.2), layout="constrained")
        for panel, metric in zip(figure.subplots(1, len(shown), squeeze=False)[0], shown, strict=True):
            lifelong = "avg_throughput" in metrics
            _draw_panel(panel, metric, metrics[metric], _published_points(published, metric, lifelong))
        legends = [panel.get_legend_handles_labels() for panel in figure.axes]
        handles = {label: line for lines, labels in legends for line, label in zip(lines, labels, strict=True)}
        figure.legend(handles.values(), handles, fontsize=8, loc="outside lower center", ncols=len(shown) + 1)
        figure.suptitle(_escaped(task_name))
        file = folder / f"{names[task_name]}.{format}"
        with replacing(file) as temporary:
            figure.savefig(temporary, format=format, dpi=110)
        yield file


def _file_names(tasks: Iterable[str]) -> dict[str, str]:
    """Return a file name for each task, without punctuation; those that would be the same are numbered."""
    names: dict[str, str] = {}
    for task in tasks:
        base = "".join(char if char.isalnum() else "-" for char in task)
        candidates = (base if number == 1 else f"{base}-{number}" for number in count(1))
        names[task] = next(name for name in candidates if name not in names.values())
    return names


def _published_points(published: Sequence[PublishedEpisode], metric: str, lifelong: bool) -> dict[str, Points]:
    """Return the values of a metric by algorithm and number of agents."""
    lines: dict[str, Points] = {}
    for episode in published:
        if episode.lifelong == lifelong and metric in episode.metrics:
            points = lines.setdefault(episode.algorithm, {})
            points.setdefault(episode.num_agents, []).append(episode.metrics[metric])
    return lines


def _escaped(name: str) -> str:
    """Escape text for matplotlib, which shows text between two `$` as a formula, and repeats it in comments of SVG."""
    return printable(name).replace("$", r"\$")


def _draw_panel(panel: Axes, metric: str, lines: dict[str, Points], published: dict[str, Points]) -> None:
    """Plot the means of a metric with their 95 % intervals, a line for each policy; published ones without interval."""
    for policy, points in lines.items():
        agents = sorted(points)
        ends = np.array([interval(metric, points[count]) for count in agents])
        means = [float(np.mean(points[count])) for count in agents]
        panel.plot(agents, means, marker="o", markersize=3, label=_escaped(policy))
        panel.fill_between(agents, ends[:, 0], ends[:, 1], alpha=0.2)
    for number, (name, points) in enumerate(published.items()):
        agents = sorted(points)
        means = [float(np.mean(points[count])) for count in agents]
        gray = str(0.15 + 0.6 * number / len(published))
        marker = MARKERS[number % len(MARKERS)]
        label = f"{_escaped(name)} (published)"
        panel.plot(agents, means, linestyle="--", linewidth=1, marker=marker, markersize=3, color=gray, label=label)
    panel.set(xlabel="agents", ylabel=LABELS[metric])
    if metric == "step_ms":
        panel.set_yscale("log")
    elif not metric.startswith("SoC_ratio"):
        panel.set_ylim(bottom=0)
