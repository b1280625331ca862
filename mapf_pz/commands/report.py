"""The command `mapf-pz report`: tables and figures of an evaluation, for papers."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, UseAppendAction

from mapf_pz._internal.atomic import write_whole
from mapf_pz.evaluation.reports.aggregates import improvements, interquartile_means
from mapf_pz.evaluation.reports.figures import FigureFormat, draw_figures
from mapf_pz.evaluation.reports.formats import FORMATS, TableFormat
from mapf_pz.evaluation.reports.overview import draw_overview
from mapf_pz.evaluation.reports.published import published_episodes
from mapf_pz.evaluation.reports.report import (
    COLUMNS,
    SummaryTable,
    check_columns,
    check_methods,
    differences,
    summaries,
)
from mapf_pz.evaluation.results import Episode, read_episodes

Statistic = Literal["mean", "difference", "iqm", "improvement"]


@dataclass(frozen=True)
class ReportOptions:
    """Options of `mapf-pz report`: evaluations, columns and formats."""

    folders: Positional[tuple[Path, ...]]
    """Folders of evaluations: `mapf-pz evaluate --output FOLDER`."""
    columns: tuple[str, ...] = COLUMNS
    """Columns of the table, in order; those without values are omitted. Metrics of costs are also available for solved
    episodes only, such as `"SoC (solved)"`."""
    format: TableFormat = "markdown"
    """Format of the table; `latex` requires the package booktabs."""
    statistic: Statistic | None = None
    """What the table shows of each policy: in each task the `mean`, or the mean `difference` to the baseline in the
    same episodes; over all tasks the interquartile mean `iqm` of the tasks' means, or the probability of `improvement`:
    to be better than the baseline in an episode. Default: `difference` with a baseline, otherwise `mean`."""
    baseline: str | None = None
    """Policy or method to compare with."""
    method: Annotated[tuple[str, ...], UseAppendAction] = ()
    """NAME=PATTERN: policies that match the pattern, such as "ours=runs/seed-*", are runs of one method with different
    training seeds, and have one row, with intervals over the runs; may be given several times."""
    output: Path | None = None
    """File of the table. Default: the table is printed."""
    figures: Path | None = None
    """Folder for a figure of each task with several numbers of agents, the performance profiles over all tasks, and
    the mean scores in each suite."""
    figure_format: FigureFormat = "pdf"
    """Format of the figures."""
    published: bool = True
    """Add the published results of the same instances, if the episodes are of a suite `pogema-*` of this version."""


def report(options: ReportOptions) -> None:
    """Make a table and figures of evaluations, with means and 95 % confidence intervals."""
    check_columns(options.columns)
    episodes = [episode for folder in options.folders for episode in read_episodes(folder)]
    published = published_episodes(episodes) if options.published else []
    table = _table(options, [*episodes, *published])
    text = FORMATS[options.format](table)
    if options.output is None:
        sys.stdout.write(text)
    else:
        write_whole(options.output, text.encode())
    if options.figures is not None:
        files = draw_figures(episodes, options.figures, options.figure_format, published)
        files += draw_overview(episodes, options.figures, options.figure_format, _methods(options))
        for file in files:
            print(f"figure written to {file}", file=sys.stderr)


def _table(options: ReportOptions, episodes: list[Episode]) -> SummaryTable:
    """Return the table of the chosen statistic."""
    statistic = options.statistic or ("mean" if options.baseline is None else "difference")
    methods = _methods(options)
    check_methods(episodes, methods)
    if (options.baseline is None) != (statistic in ("mean", "iqm")):
        raise ValueError(f"statistic={statistic!r}: expected {'no' if options.baseline else 'a'} baseline")
    if statistic == "difference":
        return differences(episodes, str(options.baseline), options.columns, methods)
    if statistic == "improvement":
        return improvements(episodes, str(options.baseline), options.columns, methods)
    return (summaries if statistic == "mean" else interquartile_means)(episodes, options.columns, methods)


def _methods(options: ReportOptions) -> dict[str, str]:
    return dict(map(_named_pattern, options.method))


def _named_pattern(text: str) -> tuple[str, str]:
    name, _, pattern = text.partition("=")
    if not name or not pattern:
        raise ValueError(f"--method {text}: expected NAME=PATTERN")
    return name, pattern
