"""Tables of summaries: for the terminal, in Markdown, LaTeX and CSV."""

from __future__ import annotations

import csv
import html
import io
from collections.abc import Callable, Iterable, Sequence
from typing import Literal

from rich.markup import escape
from rich.table import Table

from mapf_pz._internal.printable import printable, to_cell
from mapf_pz.evaluation.reports.report import COLUMNS, Estimate, SummaryTable, summaries
from mapf_pz.evaluation.results import Episode

TableFormat = Literal["markdown", "latex", "csv"]
_LATEX = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    **{char: f"\\{char}" for char in "&%$#_{}"},
}


def cells(table: SummaryTable) -> list[list[str]]:
    """Return the header, and a row for each task and policy, with means and their 95 % intervals."""
    counts = ["runs", "episodes"] if any(row.runs > 1 for row in table.rows) else ["episodes"]
    body = [
        [
            row.task,
            "" if row.num_agents is None else str(row.num_agents),
            row.policy,
            *(str(getattr(row, count)) for count in counts),
            *(_cell(row.estimates.get(n)) for n in table.columns),
        ]
        for row in table.rows
    ]
    return [["task", "agents", "policy", *counts, *table.columns], *body]


def terminal_table(episodes: Iterable[Episode], columns: Sequence[str] = COLUMNS) -> Table:
    """Return the table of episodes for a terminal, with some of the columns `ALL_COLUMNS`."""
    summary = summaries(episodes, columns)
    header, *body = cells(summary)
    table = Table(*header, title="mean [95 % interval]", caption=_suites(summary) or None)
    for row in body:
        table.add_row(*map(escape, row))
    return table


def markdown_table(episodes: Iterable[Episode], columns: Sequence[str] = COLUMNS) -> str:
    """Return the table of episodes in Markdown, with some of the columns `ALL_COLUMNS`."""
    return markdown(summaries(episodes, columns))


def markdown(table: SummaryTable) -> str:
    """Return a table in Markdown."""
    header, *body = cells(table)
    lines = [header, ["---"] * len(header), *body]
    text = "".join(f"| {' | '.join(map(_markdown_cell, line))} |\n" for line in lines)
    return f"{text}\n{_suites(table)}\n" if table.suites else text


def latex(table: SummaryTable) -> str:
    """Return a `tabular` for the package booktabs; a rule separates the tasks."""
    header, *body = cells(table)
    lines = [f"\\begin{{tabular}}{{lrl{'r' * (len(header) - 3)}}}", r"\toprule", _latex_row(header), r"\midrule"]
    for before, row in zip([None, *body], body, strict=False):
        if before is not None and before[:2] != row[:2]:
            lines.append(r"\midrule")
        lines.append(_latex_row(row))
    comments = [f"% {_suites(table)}"] if table.suites else []
    return "\n".join([*comments, *lines, r"\bottomrule", r"\end{tabular}", ""])


def comma_separated(table: SummaryTable) -> str:
    """Return a table as CSV; each column has the mean and, in two more, the ends of its 95 % interval."""
    text = io.StringIO(newline="")
    out = csv.writer(text, lineterminator="\n")
    ends = [part for name in table.columns for part in (name, f"{name} low", f"{name} high")]
    out.writerow(["task", "num_agents", "policy", "runs", "episodes", *ends, "suite"])
    for each in table.rows:
        found = [each.estimates.get(name) for name in table.columns]
        values = [number for e in found for number in (("", "", "") if e is None else (e.mean, e.low, e.high))]
        suite, task, policy = map(to_cell, (each.suite, each.task, each.policy))
        out.writerow([task, each.num_agents, policy, each.runs, each.episodes, *values, suite])
    return text.getvalue()


FORMATS: dict[TableFormat, Callable[[SummaryTable], str]] = {
    "markdown": markdown,
    "latex": latex,
    "csv": comma_separated,
}
"""The functions that format tables, by name."""


def _suites(table: SummaryTable) -> str:
    """Return a line with the suites of a table; empty if there are none."""
    return f"Suite{'s' * (len(table.suites) > 1)}: {printable(', '.join(table.suites))}" if table.suites else ""


def _cell(estimate: Estimate | None) -> str:
    if estimate is None:
        return ""
    mean, low, high = (f"{round(value, 9):.3g}" for value in (estimate.mean, estimate.low, estimate.high))
    return mean if low == high else f"{mean} [{low}, {high}]"


def _markdown_cell(cell: str) -> str:
    """Return the text of a cell of Markdown, without HTML."""
    return html.escape(cell, quote=False).replace("|", "\\|")


def _latex_row(cells: Sequence[str]) -> str:
    return " & ".join("".join(_LATEX.get(char, char) for char in cell) for cell in cells) + r" \\"
