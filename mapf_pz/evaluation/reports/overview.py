"""Figures over all tasks of an evaluation: performance profiles, and the scores in each suite."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mapf_pz._internal.atomic import replacing
from mapf_pz.evaluation.reports.aggregates import Profile, mean_scores, performance_profiles
from mapf_pz.evaluation.reports.figures import COLORS, LABELS, MARKERS, FigureFormat, escaped
from mapf_pz.evaluation.reports.report import NO_METHODS, Estimate, Methods, method_of
from mapf_pz.evaluation.results import Episode

SHARES = ("CSR", "ISR")
"""Columns that have profiles: shares from 0 to 1, so that the scores of all tasks can be compared."""
SCORES = (*SHARES, "avg_throughput")
"""Columns whose scores are drawn by suite."""
THRESHOLDS = np.linspace(0, 1, 101)
SPREAD = 0.6
"""Width in which the methods of a suite are side by side, where suites are 1 apart."""


def draw_overview(
    episodes: Sequence[Episode], folder: Path, format: FigureFormat = "png", methods: Methods = NO_METHODS
) -> list[Path]:
    """Save figures over all tasks, and return the files.

    `performance-profiles` shows the share of the scores above each threshold, where a score is the mean of a run in a
    task (Agarwal et al., NeurIPS 2021); it is drawn if there are two tasks or more. `suites` shows the mean score of
    each method in each suite, if there are two suites or more. Both have 95 % intervals.

    Args:
        episodes: the episodes.
        folder: the folder of the files; it is created if it does not exist.
        format: the format of the files; `pdf` and `svg` are vector graphics.
        methods: patterns of the runs of methods, as in `summaries`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    names = list(dict.fromkeys(method_of(episode.policy, methods) for episode in episodes))
    figures: dict[str, Figure] = {}
    if len({(episode.task, episode.num_agents) for episode in episodes}) > 1:
        profiles = {column: performance_profiles(episodes, column, THRESHOLDS, methods) for column in SHARES}
        figures["performance-profiles"] = _profile_figure(
            {name: each for name, each in profiles.items() if each}, names
        )
    suites: dict[str, list[Episode]] = {}
    for episode in episodes:
        suites.setdefault(episode.suite.partition("/")[0] or episode.task, []).append(episode)
    if len(suites) > 1:
        figures["suites"] = _suite_figure(suites, methods, names)
    return [_save(figure, folder / f"{name}.{format}", format) for name, figure in figures.items() if figure.axes]


def _save(figure: Figure, file: Path, format: FigureFormat) -> Path:
    lines = {text: line for panel in figure.axes for line, text in zip(*panel.get_legend_handles_labels(), strict=True)}
    figure.legend(lines.values(), lines, fontsize=8, loc="outside lower center", ncols=2 * len(figure.axes))
    with replacing(file) as temporary:
        figure.savefig(temporary, format=format, dpi=110)
    return file


def _profile_figure(profiles: Mapping[str, Mapping[str, Profile]], names: Sequence[str]) -> Figure:
    """Return a figure with a panel for each column."""
    figure = Figure(figsize=(6 * max(1, len(profiles)), 4.5), layout="constrained")
    for k, (column, by_method) in enumerate(profiles.items()):
        panel = figure.add_subplot(1, len(profiles), k + 1)
        for name, (shares, low, high) in by_method.items():
            color = COLORS[names.index(name) % len(COLORS)]
            panel.step(THRESHOLDS, shares, where="post", color=color, label=escaped(name))
            panel.fill_between(THRESHOLDS, low, high, step="post", color=color, alpha=0.15, linewidth=0)
        panel.set(xlabel=f"threshold of {column}", ylabel="runs and tasks above it", xlim=(0, 1), ylim=(0, 1.02))
        panel.grid(alpha=0.3)
    return figure


def _suite_figure(suites: Mapping[str, Sequence[Episode]], methods: Methods, names: Sequence[str]) -> Figure:
    """Return a figure with a panel for each column, in which methods are side by side in each suite."""
    scores = {
        column: {suite: mean_scores(episodes, column, methods) for suite, episodes in suites.items()}
        for column in SCORES
    }
    shown = {column: by_suite for column, by_suite in scores.items() if any(by_suite.values())}
    figure = Figure(figsize=(max(6.0, 1.2 * len(suites)) * max(1, len(shown)), 4.5), layout="constrained")
    for k, (column, by_suite) in enumerate(shown.items()):
        panel = figure.add_subplot(1, len(shown), k + 1)
        present = [suite for suite, by_method in by_suite.items() if by_method]
        for number, name in enumerate(names):
            estimates = {at: by_suite[suite][name] for at, suite in enumerate(present) if name in by_suite[suite]}
            _draw_points(panel, name, number, SPREAD * ((number + 0.5) / len(names) - 0.5), estimates)
        panel.set_xticks(range(len(present)), [escaped(suite) for suite in present], rotation=20, ha="right")
        panel.set(ylabel=LABELS[column], xlim=(-0.5, len(present) - 0.5), ylim=(0, None))
        panel.grid(alpha=0.3, axis="y")
    return figure


def _draw_points(panel: Axes, name: str, number: int, shift: float, estimates: Mapping[int, Estimate]) -> None:
    """Draw the means of a method, by position, with their intervals."""
    if not estimates:
        return
    color, marker = COLORS[number % len(COLORS)], MARKERS[number % len(MARKERS)]
    at = [position + shift for position in estimates]
    panel.vlines(
        at, [one.low for one in estimates.values()], [one.high for one in estimates.values()], colors=color, alpha=0.7
    )
    means = [one.mean for one in estimates.values()]
    panel.plot(at, means, linestyle="none", color=color, marker=marker, markersize=5, label=escaped(name))
