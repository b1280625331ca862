"""The progress file of a training run: a row of numbers after each update."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from itertools import islice
from pathlib import Path

from mapf_pz._internal.atomic import write_whole
from mapf_pz.errors import FormatError

PROGRESS = "progress.csv"
"""The file's name in the run's folder."""

Row = dict[str, float]


def read_progress(run: Path, updates: int | None = None) -> list[Row]:
    """Return the rows of the run in a folder, at most the first `updates`.

    Raises:
        FileNotFoundError: There is no such file.
        FormatError: Some of the rows are damaged.
    """
    file = run / PROGRESS
    try:
        with file.open(newline="") as lines:
            rows = list(islice(csv.DictReader(lines), updates))
        return [{key: float(value) for key, value in row.items()} for row in rows]
    except (ValueError, TypeError, csv.Error) as error:
        raise FormatError(file, f"damaged: {error}") from None


def write_progress(run: Path, rows: Sequence[Row]) -> None:
    """Replace the file of the run in a folder; all rows have the same keys."""
    write_whole(run / PROGRESS, "".join(map(_line, [list(rows[0]), *map(_texts, rows)])).encode())


def append_progress(run: Path, row: Row, is_first: bool) -> None:
    """Append a row to the file of the run in a folder; the first row begins a new file."""
    lines = [list(row), _texts(row)] if is_first else [_texts(row)]
    with (run / PROGRESS).open("w" if is_first else "a", newline="") as file:
        file.write("".join(map(_line, lines)))


def _texts(row: Row) -> list[str]:
    """Format numbers with six digits, and counts in full."""
    return [f"{value:.0f}" if key == "agent_steps" else f"{value:.6g}" for key, value in row.items()]


def _line(cells: list[str]) -> str:
    return ",".join(cells) + "\r\n"
