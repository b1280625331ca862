"""Studies: runs of settings with several seeds, whose results are in a file and are not measured again."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from experiments.pages import key_of, read_rows, write_rows

Run = TypeVar("Run", bound="tuple[str | int | float, ...]")


@dataclass(frozen=True)
class Study:
    """The results of runs, in a CSV file of `docs/results/`. To repeat a run, remove its rows."""

    file: Path
    """The file; without it, there are no results yet."""
    key: tuple[str, ...]
    """Columns that determine a run, such as its setting and its seed."""
    measures: tuple[str, ...]
    """The other columns; cells without a value are empty."""

    @property
    def columns(self) -> tuple[str, ...]:
        """All columns."""
        return (*self.key, *self.measures)

    def rows(self) -> list[dict[str, str]]:
        """Return the rows of the file, in the order in which they were measured."""
        return read_rows(self.file)

    def missing(self, runs: Iterable[Run]) -> Iterator[Run]:
        """Yield the runs without results, each as the values of `key`. One whose results are added meanwhile is not."""
        for run in runs:
            if tuple(map(str, run)) not in [key_of(row, self.key) for row in self.rows()]:
                yield run

    def add(self, run: tuple[str | int | float, ...], *measured: Mapping[str, str]) -> None:
        """Write the rows of a run to the file, after those of the others, and print them."""
        rows = [dict(zip(self.key, map(str, run), strict=True)) | dict(values) for values in measured]
        self.write([*self.rows(), *rows])
        for row in rows:
            print(row, flush=True)

    def write(self, rows: Sequence[Mapping[str, str]]) -> None:
        """Write these rows instead of those of the file."""
        write_rows(self.file, rows, self.columns)


@dataclass(frozen=True, kw_only=True)
class StudyOptions:
    """What every study can be asked for."""

    write: bool = False
    """Only write tables and figures from the results."""


def check_known(kind: str, names: Sequence[str], known: Sequence[str]) -> None:
    """Exit if some of the names are unknown; `kind` is what they are names of, in the plural."""
    if unknown := set(names) - set(known):
        raise SystemExit(f"{kind} {', '.join(sorted(unknown))}: expected some of {', '.join(dict.fromkeys(known))}")


def folder(output: Path, name: str, seed: int) -> Path:
    """Return the folder of a run: the name of its setting, as a folder's name, and its seed."""
    return output / f"{name.replace(',', '').replace(' ', '-')}-{seed}"
