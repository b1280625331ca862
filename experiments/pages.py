"""Pages on experiments: files of results, and tables, each between `<!-- NAME -->` and `<!-- end of NAME -->`."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

PAGES = Path(__file__).parents[1] / "docs" / "explanation"
"""Folder of the pages."""
FILES = PAGES.parent / "results"
"""Folder of the files of results."""


def read_rows(path: Path) -> list[dict[str, str]]:
    """Return the rows of a CSV file by column; none if it does not exist."""
    if not path.exists():
        return []
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def write_rows(path: Path, rows: Sequence[Mapping[str, str]], columns: Sequence[str]) -> None:
    """Write rows to a CSV file; cells without a value are empty."""
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, columns, restval="", lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def key_of(row: Mapping[str, str], columns: Iterable[str]) -> tuple[str, ...]:
    """Return the values of a row in the columns that determine it."""
    return tuple(row[column] for column in columns)


def write_table(page: Path, name: str, lines: Iterable[str]) -> None:
    """Replace the table of this name in a page by the lines of another."""
    before, start, rest = page.read_text().partition(f"<!-- {name} -->\n")
    _, end, after = rest.partition(f"<!-- end of {name} -->")
    if not end:
        raise ValueError(f"{page.name}: expected a table between <!-- {name} --> and <!-- end of {name} -->")
    page.write_text("\n".join([before + start, *lines, "", end + after]))


def spread(values: Sequence[float] | np.ndarray, digits: int, form: str = "f") -> str:
    """Format a mean, with the minimum and the maximum of several values unless they look the same.

    `digits` are those after the decimal point, or with the form "g" the significant ones.
    """
    mean, low, high = (f"{value:.{digits}{form}}" for value in (np.mean(values), np.min(values), np.max(values)))
    return mean if low == high else f"{mean} ({low} to {high})"


def setting_lines(rows: Sequence[Mapping[str, str]], metrics: Mapping[str, int]) -> Iterator[str]:
    """Yield a line of a table for each `setting` of the rows: the metrics over its seeds, with their digits."""
    for setting in dict.fromkeys(row["setting"] for row in rows):
        chosen = [row for row in rows if row["setting"] == setting]
        columns = {metric: [float(row[metric]) for row in chosen if row[metric]] for metric in metrics}
        cells = [spread(values, metrics[metric]) if values else "" for metric, values in columns.items()]
        yield f"| {setting} | {' | '.join(cells)} |"
