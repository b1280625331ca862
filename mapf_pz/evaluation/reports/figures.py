"""Figures of evaluated episodes: success, throughput and time by the number of agents."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import count
from pathlib import Path
from types import MappingProxyType
from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mapf_pz._internal.atomic import replacing
from mapf_pz._internal.printable import printable
from mapf_pz.evaluation.reports.intervals import interval
from mapf_pz.evaluation.reports.report import SOLVED, grouped, suites_by_task
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

Points = dict[int, tuple[float, float, float]]
"""The mean of a metric and its 95 % interval, by the number of agents."""
Lines = dict[str, dict[str, Points]]
"""The lines of a task's panels: points by metric and policy."""


def draw_figures(
    episodes: Sequence[Episode],
    folder: Path,
    format: FigureFormat = "png",
    published: Sequence[Episode] = (),
) -> list[Path]:
    """Save a figure of each task with several numbers of agents, and return the files.

    Args:
        episodes: the episodes.
        folder: the folder of the files, which are named by the tasks; it is created if it does not exist.
        format: the format of the files; `pdf` and `svg` are vector graphics.
        published: published results of the same tasks, which are drawn as dashed lines.

    Raises `ValueError` if a task is of several suites or of several versions of one.
    """
    suites = {task: suite for (task, _), suite in suites_by_task(episodes).items()}
    return draw_tasks(_by_task(episodes), suites, folder, format, _by_task(published))


def _by_task(episodes: Iterable[Episode]) -> dict[str, Lines]:
    """Return the lines of each task."""
    by_task: dict[str, Lines] = {}
    for (task_name, num_agents, policy), values in grouped(episodes).items():
        for metric in (name for name in LABELS if name in values):
            lines = by_task.setdefault(task_name, {}).setdefault(metric, {})
            mean = float(np.mean(values[metric]))
            lines.setdefault(policy, {})[num_agents] = (mean, *interval(metric, values[metric]))
    return by_task


def draw_tasks(
    by_task: Mapping[str, Lines],
    suites: Mapping[str, str],
    folder: Path,
    format: FigureFormat = "png",
    published: Mapping[str, Lines] = MappingProxyType({}),
) -> list[Path]:
    """Save the figures of `draw_figures` of tasks whose means are known, and return the files.

    Args:
        by_task: the lines of each task.
        suites: the label of each task's suite; empty if there is none.
        folder: as in `draw_figures`.
        format: as in `draw_figures`.
        published: the published lines of each task.
    """
    folder.mkdir(parents=True, exist_ok=True)
    return list(_draw(by_task, suites, folder, format, published))


def _draw(
    by_task: Mapping[str, Lines],
    suites: Mapping[str, str],
    folder: Path,
    format: FigureFormat,
    published: Mapping[str, Lines],
) -> Iterator[Path]:
    names = _file_names(by_task)
    for task_name, metrics in by_task.items():
        others = published.get(task_name, {})
        shown = [name for name in LABELS if name in metrics]
        if not shown or max(len(points) for points in metrics[shown[0]].values()) < 2:
            continue
        figure = Figure(figsize=(4.2 * len(shown), 4.2), layout="constrained")
        for panel, metric in zip(figure.subplots(1, len(shown), squeeze=False)[0], shown, strict=True):
            _draw_panel(panel, metric, metrics[metric], others.get(metric, {}))
        legends = [panel.get_legend_handles_labels() for panel in figure.axes]
        handles = {label: line for lines, labels in legends for line, label in zip(lines, labels, strict=True)}
        figure.legend(handles.values(), handles, fontsize=8, loc="outside lower center", ncols=len(shown) + 1)
        figure.suptitle(_escaped(f"{task_name} ({suites[task_name]})" if suites[task_name] else task_name))
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


def _escaped(name: str) -> str:
    """Escape text for matplotlib, which shows text between two `$` as a formula, and repeats it in comments of SVG."""
    return printable(name).replace("$", r"\$")


def _draw_panel(panel: Axes, metric: str, lines: dict[str, Points], published: dict[str, Points]) -> None:
    """Plot the means of a metric with their 95 % intervals, a line for each policy; published ones without interval."""
    for policy, points in lines.items():
        agents = sorted(points)
        means, low, high = np.array([points[count] for count in agents]).T
        panel.plot(agents, means, marker="o", markersize=3, label=_escaped(policy))
        panel.fill_between(agents, low, high, alpha=0.2)
    for number, (name, points) in enumerate(published.items()):
        agents = sorted(points)
        means = [points[count][0] for count in agents]
        gray = str(0.15 + 0.6 * number / len(published))
        marker = MARKERS[number % len(MARKERS)]
        label = _escaped(name)
        panel.plot(agents, means, linestyle="--", linewidth=1, marker=marker, markersize=3, color=gray, label=label)
    panel.set(xlabel="agents", ylabel=LABELS[metric])
    if metric == "step_ms":
        panel.set_yscale("log")
    elif not metric.startswith("SoC_ratio"):
        panel.set_ylim(bottom=0)
