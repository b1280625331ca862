"""The command `mapf-pz maps`: list the bundled maps, write their files, or download the benchmark."""

from __future__ import annotations

import logging
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from rich.console import Console
from rich.progress import BarColumn, DownloadColumn, Progress, TaskID, TextColumn, TransferSpeedColumn
from tyro.conf import Positional, subcommand

from mapf_pz.instances import generate_bundled, load_map, map_names
from mapf_pz.instances.archive import ARCHIVES
from mapf_pz.instances.download import Show, cache_folder, download
from mapf_pz.interrupts import interruptible


@dataclass(frozen=True)
class ListMaps:
    """List the bundled maps: name, rows x columns, free cells."""


@dataclass(frozen=True)
class GenerateMaps:
    """Write the files of the bundled maps."""

    folder: Positional[Path]
    """Where to; it is made where it is missing."""


@dataclass(frozen=True)
class DownloadMaps:
    """Download the MovingAI benchmark, whose maps and scenarios are known by their names from then on."""

    scenarios: Literal["random", "even", "both"] = "both"
    """Which scenarios: goals anywhere, goals at evenly distributed distances, or both."""
    folder: Path | None = None
    """Where to, if not to the user's cache (or `MAPF_PZ_CACHE`); `MAPF_PZ_BENCHMARK` must name it then."""


def maps(
    task: Annotated[ListMaps, subcommand("list")]
    | Annotated[GenerateMaps, subcommand("generate")]
    | Annotated[DownloadMaps, subcommand("download")],
) -> None:
    """List the bundled maps, write their files, or download the benchmark."""
    match task:
        case ListMaps():
            _list()
        case GenerateMaps(folder):
            print(f"{len(generate_bundled(folder))} maps written to {folder}")
        case DownloadMaps(scenarios, folder):
            _download(scenarios, folder or cache_folder())


def _list() -> None:
    names = map_names()
    for name in names:
        grid = load_map(name)
        print(f"{name:{max(map(len, names))}} {grid.shape[0]:4} x {grid.shape[1]:<4} {grid.free.sum():6} free cells")


def _download(scenarios: Literal["random", "even", "both"], folder: Path) -> None:
    import pooch

    pooch.get_logger().setLevel(logging.WARNING)  # the bar tells what it would tell
    names = ["maps", *(("random", "even") if scenarios == "both" else (scenarios,))]
    with interruptible() as check, _progress_bar() as show:

        def show_and_check(name: str, here: int, total: int | None) -> None:
            check()
            show(name, here, total)

        written = download([ARCHIVES[name] for name in names], folder, show_and_check)
    print(f"{written} files written to {folder}" if written else f"all files are in {folder} already")


@contextmanager
def _progress_bar() -> Generator[Show]:
    """Show a bar for each archive; yield what feeds it."""
    columns = (TextColumn("{task.description}"), BarColumn(), DownloadColumn(), TransferSpeedColumn())
    console = Console(stderr=True)
    tasks: dict[str, TaskID] = {}
    with Progress(*columns, console=console, disable=not console.is_terminal) as bar:

        def show(name: str, here: int, total: int | None) -> None:
            if name not in tasks:
                tasks[name] = bar.add_task(name, total=total)
            bar.update(tasks[name], completed=here)

        yield show
