"""The progress bar of commands, on standard error if it is a terminal."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from functools import partial
from typing import Protocol

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn


class Update(Protocol):
    """Updates a progress bar; what is omitted does not change."""

    def __call__(
        self,
        *,
        total: float | None = None,
        completed: float | None = None,
        advance: float | None = None,
        description: str | None = None,
        state: str = ...,
    ) -> None:
        """Set the total or the completed amount, add to the latter, or change the text before or after the bar."""


@contextmanager
def progress_bar(
    title: str, total: float | None = None, console: Console | None = None, transient: bool = True
) -> Generator[Update]:
    """Show a progress bar; yield the function that updates it.

    Args:
        title: the text before the bar.
        total: the amount of work. None: unknown so far.
        console: where the bar is shown. None: on standard error.
        transient: whether the bar disappears at the end.
    """
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[state]}"),
    )
    console = console or Console(stderr=True)
    with Progress(*columns, console=console, transient=transient, disable=not console.is_terminal) as bar:
        yield partial(bar.update, bar.add_task(title, total=total, state=""))
