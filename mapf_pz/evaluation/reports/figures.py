"""Figures of evaluated episodes: success, throughput and time by the number of agents."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import count
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, NamedTuple

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
    f"weighted_cost_ratio{SOLVED}": "weighted cost / lower bound (solved)",
    f"delayed_SoC_ratio{SOLVED}": "sum of costs / that of agents alone (solved)",
    "avg_throughput": "goals reached per step",
    "step_ms": "milliseconds per step",
}
"""The metrics to plot, if episodes have them."""

MARKERS = "osv^D<>pPXh*d"
COLORS = tuple(f"C{number}" for number in range(10))
"""Markers and colors of policies in turn: their numbers have no common divisor, so that all pairs come."""
PANELS_PER_ROW = 2
MOST_TICKS = 10
"""Maximum number of numbers of agents that are all named below a panel."""
MOST_NAMED = 10
"""Maximum number of policies in a figure that are all named."""
NUM_BEST, NUM_BEST_PUBLISHED = 5, 3
"""Numbers of evaluated policies and of published methods that are named in a figure of more."""
SHIFT = 0.004
"""Distance of a policy's points from those of the one before, as a fraction of the axis of agents."""

_BAND = "the others, from minimum to maximum"

Points = dict[int, tuple[float, float, float]]
"""The mean of a metric and its 95 % interval, by the number of agents."""
Lines = dict[str, dict[str, Points]]
"""The lines of a task's panels: points by metric and policy."""


class Style(NamedTuple):
    """How a policy is drawn, in all panels of all figures."""

    number: int
    """Position among all policies."""
    published: bool
    """Whether it is a published method, which has dashed lines and open markers."""

    @property
    def keywords(self) -> dict[str, Any]:
        """The keywords of its lines."""
        color, marker = COLORS[self.number % len(COLORS)], MARKERS[self.number % len(MARKERS)]
        others = {"linestyle": "--", "linewidth": 1, "markerfacecolor": "white"} if self.published else {}
        return {"color": color, "marker": marker, "markersize": 4} | others


def draw_figures(
    episodes: Sequence[Episode],
    folder: Path,
    format: FigureFormat = "png",
    published: Sequence[Episode] = (),
) -> list[Path]:
    """Save a figure of each task with several numbers of agents, and return the files.

    A figure of more than 10 policies names the best five and, of the published methods, the best three, by the mean of
    the first metric over the numbers of agents. The others are a gray band from their minimum to their maximum.

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
    styles = _styles(by_task, published)
    for task_name, metrics in by_task.items():
        others = published.get(task_name, {})
        shown = [name for name in LABELS if name in metrics]
        if not shown or max(len(points) for points in metrics[shown[0]].values()) < 2:
            continue
        columns = min(len(shown), PANELS_PER_ROW)
        rows = -(-len(shown) // columns)
        figure = Figure(figsize=(6 * columns, 4 * rows + 1), layout="constrained")
        panels = figure.subplots(rows, columns, squeeze=False).flatten()
        for panel in panels[len(shown) :]:
            panel.remove()
        named = _named(*({name: lines.get(name, {}) for name in shown} for lines in (metrics, others)))
        for panel, metric in zip(panels, shown, strict=False):
            lines = metrics[metric] | others.get(metric, {})
            _draw_band(panel, {policy: points for policy, points in lines.items() if policy not in named})
            _draw_panel(panel, metric, {policy: lines[policy] for policy in lines if policy in named}, styles)
        legends = [panel.get_legend_handles_labels() for panel in figure.axes]
        handles = {label: line for lines, labels in legends for line, label in zip(lines, labels, strict=True)}
        ordered = {label: handles[label] for label in (*map(escaped, styles), _BAND) if label in handles}
        figure.legend(ordered.values(), ordered, fontsize=8, loc="outside lower center", ncols=2 * columns)
        figure.suptitle(escaped(f"{task_name} ({suites[task_name]})" if suites[task_name] else task_name))
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


def escaped(name: str) -> str:
    """Escape text for matplotlib, which shows text between two `$` as a formula, and repeats it in comments of SVG."""
    return printable(name).replace("$", r"\$")


def _styles(by_task: Mapping[str, Lines], published: Mapping[str, Lines]) -> dict[str, Style]:
    """Return the style of each policy of all tasks, in the order in which they come first, published ones last."""
    policies = {
        policy: is_published
        for tasks, is_published in ((by_task, False), (published, True))
        for metrics in tasks.values()
        for lines in metrics.values()
        for policy in lines
    }
    return {policy: Style(number, is_published) for number, (policy, is_published) in enumerate(policies.items())}


def _named(own: Lines, published: Lines) -> set[str]:
    """Return the policies of a figure that are named: all, or the best by the first metric, of which more is better."""
    policies = {policy for lines in (own, published) for each in lines.values() for policy in each}
    if len(policies) <= MOST_NAMED:
        return policies
    return {*_best(own, NUM_BEST), *_best(published, NUM_BEST_PUBLISHED)}


def _best(lines: Lines, number: int) -> list[str]:
    first = next(iter(lines.values()))
    totals = {policy: sum(mean for mean, _, _ in points.values()) for policy, points in first.items()}
    return sorted(totals, key=lambda policy: -totals[policy])[:number]


def _draw_band(panel: Axes, lines: Mapping[str, Points]) -> None:
    """Draw policies without names as one band."""
    counts = sorted({count for points in lines.values() for count in points})
    means = [[points[count][0] for points in lines.values() if count in points] for count in counts]
    if counts:
        panel.fill_between(counts, [*map(min, means)], [*map(max, means)], color="0.88", label=_BAND)


def _draw_panel(panel: Axes, metric: str, lines: dict[str, Points], styles: Mapping[str, Style]) -> None:
    """Plot the means of a metric, a line for each policy, and 95 % intervals as vertical lines, not of published ones.

    The points of policies are a little beside each other, so that intervals do not cover each other.
    """
    counts = sorted({count for points in lines.values() for count in points})
    own = [policy for policy in lines if not styles[policy].published]
    for policy, points in lines.items():
        style = styles[policy]
        agents = np.array(sorted(points), np.float64)
        means, low, high = np.array([points[count] for count in sorted(points)]).T
        if not style.published:
            agents += SHIFT * (counts[-1] - counts[0]) * (own.index(policy) - (len(own) - 1) / 2)
            panel.vlines(agents, low, high, colors=style.keywords["color"], linewidth=1.5, alpha=0.7)
        panel.plot(agents, means, label=escaped(policy), **style.keywords)
    panel.set(xlabel="agents", ylabel=LABELS[metric])
    if len(counts) <= MOST_TICKS:
        panel.set_xticks(counts)
    panel.grid(alpha=0.3)
    if metric == "step_ms":
        panel.set_yscale("log")
    elif not metric.startswith(("SoC_ratio", "weighted_cost_ratio", "delayed_SoC_ratio")):
        panel.set_ylim(bottom=0)
