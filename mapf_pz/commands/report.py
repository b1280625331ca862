"""The command `mapf-pz report`: tables and figures of an evaluation, for papers."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

from tyro.conf import Positional

from mapf_pz._internal.atomic import write_whole
from mapf_pz.evaluation.reports.figures import FigureFormat, draw_figures
from mapf_pz.evaluation.reports.formats import FORMATS, TableFormat
from mapf_pz.evaluation.reports.published import published_episodes
from mapf_pz.evaluation.reports.report import ALL_COLUMNS, COLUMNS, differences, summaries
from mapf_pz.evaluation.results import read_episodes


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
    baseline: str | None = None
    """Show the mean differences to this policy on the same episodes instead of the means."""
    output: Path | None = None
    """File of the table. Default: the table is printed."""
    figures: Path | None = None
    """Folder for a figure of each task with several numbers of agents."""
    figure_format: FigureFormat = "pdf"
    """Format of the figures."""
    published: bool = True
    """Add the published results of the same instances, if the episodes are of a suite `pogema-*` of this version."""


def report(options: ReportOptions) -> None:
    """Make a table and figures of evaluations, with means and 95 % confidence intervals."""
    unknown = [name for name in options.columns if name not in ALL_COLUMNS]
    if unknown:
        raise ValueError(f"columns {unknown}: expected some of {', '.join(map(repr, ALL_COLUMNS))}")
    episodes = [episode for folder in options.folders for episode in read_episodes(folder)]
    published = published_episodes(episodes) if options.published else []
    if options.baseline is None:
        table = summaries([*episodes, *published], options.columns)
    else:
        table = differences([*episodes, *published], options.baseline, options.columns)
    text = FORMATS[options.format](table)
    if options.output is None:
        sys.stdout.write(text)
    else:
        write_whole(options.output, text.encode())
    if options.figures is not None:
        for file in draw_figures(episodes, options.figures, options.figure_format, published):
            print(f"figure written to {file}", file=sys.stderr)
