"""Learning curves of training runs, also of several seeds and of several configurations."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mapf_pz._internal.atomic import replacing
from mapf_pz._internal.json import parse_object
from mapf_pz._internal.text import read_text
from mapf_pz.rl.config_file import CONFIG, CONFIG_FILES
from mapf_pz.rl.progress import Row, read_progress

MEANS = {
    "CSR": "all agents at their goals (CSR)",
    "ISR": "agents at their goals (ISR)",
    "throughput": "goals per step (throughput)",
    "agreement": "actions of the planner (agreement)",
    "return": "mean episode return per agent",
}
"""Columns of the progress file that can be plotted, and their labels."""
EPISODES = 100
"""Minimum number of episodes that a point of a curve is the mean of."""

_OF_ONE_RUN = ("seed", "agent_steps", "tracking")
"""Fields of a configuration in which the runs of a curve may differ."""

Points = tuple[np.ndarray, np.ndarray]
"""Million agent steps, and the values there."""


@dataclass(frozen=True)
class Run:
    """A training run, finished or not."""

    name: str
    """Its name in the legend."""
    settings: Mapping[str, object]
    """What its configuration's files contain, by name, without the seed, the length, and the name for loggers."""
    rows: Sequence[Row]
    """Its progress, one row or more."""

    @classmethod
    def read(cls, folder: Path) -> Run:
        """Return the run in a folder, without loading what its configuration names.

        Raises:
            FileNotFoundError: There is no run in the folder.
            FormatError: Its progress is damaged, or `config.json` is not JSON.
            ValueError: The run has no progress yet.
        """
        rows = read_progress(folder)
        if not rows:
            raise ValueError(f"{str(folder)!r}: expected a run with one update or more, got none")
        file = folder / CONFIG
        config = parse_object(read_text(file), file)
        settings: dict[str, object] = {name: value for name, value in config.items() if name not in _OF_ONE_RUN}
        objects = (folder / name for name in set(CONFIG_FILES) - {CONFIG})
        return cls(folder.name, settings | {file.name: file.read_bytes() for file in objects if file.exists()}, rows)

    def curve(self, column: str) -> Points:
        """Return the running mean of a column, weighted by episodes.

        Each point is the mean over the latest `EPISODES` episodes or more. Updates without an episode have none.
        """
        values = np.array([row[column] for row in self.rows])
        weights = np.array([row.get("episodes", 1.0) for row in self.rows])
        totals, counts = (
            np.concatenate([[0.0], np.cumsum(part)]) for part in (np.where(weights > 0, values * weights, 0.0), weights)
        )
        ends = np.arange(1, len(self.rows) + 1)
        needed = EPISODES if "episodes" in self.rows[0] else 1
        starts = np.minimum(np.searchsorted(counts, counts[ends] - needed, side="right") - 1, ends - 1).clip(0)
        shown = weights > 0
        ends, starts = ends[shown], starts[shown]
        steps = np.array([self.rows[end - 1]["agent_steps"] for end in ends]) / 1e6
        return steps, (totals[ends] - totals[starts]) / (counts[ends] - counts[starts])

    def validations(self, column: str) -> Points:
        """Return the results of validations; empty if there were none."""
        found = [row for row in self.rows if not math.isnan(row.get(f"validation_{column}", math.nan))]
        steps, values = ([row[name] for row in found] for name in ("agent_steps", f"validation_{column}"))
        return np.array(steps) / 1e6, np.array(values)


def draw_curves(runs: Sequence[Run], columns: Sequence[str], file: Path) -> None:
    """Save a figure of the runs' learning curves, whose format is that of the file's name, such as .png, .svg or .pdf.

    Runs that differ only in their seeds are one curve: the mean, and a band from minimum to maximum.
    Validations are drawn as points.

    Args:
        runs: the runs.
        columns: names in `MEANS`, one panel for each; those that none of the runs has are left out.
        file: the figure's file.

    Raises `ValueError` if the runs have none of the columns.
    """
    panels = [name for name in columns if any(name in run.rows[0] for run in runs)]
    if not panels:
        raise ValueError(f"expected runs with {', '.join(columns)}, got {', '.join(runs[0].rows[0])}")
    figure = Figure(figsize=(5.6 * len(panels), 4), layout="constrained")
    for axes, column in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True):
        for color, group in enumerate(_groups(runs)):
            _draw(axes, [run for run in group if column in run.rows[0]], column, f"C{color}")
        axes.set(xlabel="million agent steps", ylabel=MEANS[column])
        if column in ("CSR", "ISR", "agreement"):
            axes.set_ylim(0, 1.02)
        axes.legend(fontsize=8)
    with replacing(file) as temporary:
        figure.savefig(temporary, dpi=150)


def _groups(runs: Iterable[Run]) -> list[list[Run]]:
    """Return the runs in groups that differ only in their seeds and lengths."""
    groups: list[tuple[Mapping[str, object], list[Run]]] = []
    for run in runs:
        same = [group for settings, group in groups if settings == run.settings]
        if same:
            same[0].append(run)
        else:
            groups.append((run.settings, [run]))
    return [group for _, group in groups]


def _draw(axes: Axes, group: Sequence[Run], column: str, color: str) -> None:
    """Draw the mean and the range of a group of runs, and their validations."""
    if not group:
        return
    label = group[0].name if len(group) == 1 else f"{group[0].name}, {len(group)} seeds"
    curves = [run.curve(column) for run in group]
    longest = min(curves, key=lambda points: len(points[0]))[0]  # the steps that all of them have
    values = np.array([np.interp(longest, *points) if len(points[0]) else longest for points in curves])
    axes.plot(longest, values.mean(0), color=color, label=label, marker="o" if len(longest) < 10 else "")
    if len(group) > 1:
        axes.fill_between(longest, values.min(0), values.max(0), color=color, alpha=0.2)
    validations = [run.validations(column) for run in group]
    if any(len(steps) for steps, _ in validations):
        steps, found = (np.concatenate(parts) for parts in zip(*validations, strict=True))
        axes.plot(steps, found, "s", color=color, markersize=4, markerfacecolor="none", label=f"{label}, validation")
