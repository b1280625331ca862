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
    """Output folder, which is created if necessary."""


@dataclass(frozen=True)
class DownloadMaps:
    """Download the MovingAI benchmark, so that its maps and scenarios are available by name."""

    scenarios: Literal["random", "even", "both"] = "both"
    """Scenarios to download. `random`: random goals; `even`: evenly distributed distances; `both`."""
    folder: Path | None = None
    """Output folder, to which `MAPF_PZ_BENCHMARK` must be set. None: the user's cache, or `MAPF_PZ_CACHE`."""


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

    pooch.get_logger().setLevel(logging.WARNING)  # the progress bar shows the same
    names = ["maps", *(("random", "even") if scenarios == "both" else (scenarios,))]
    with interruptible() as check, _progress_bar() as show:

        def show_and_check(name: str, done: int, total: int | None) -> None:
            check()
            show(name, done, total)

        written = download([ARCHIVES[name] for name in names], folder, show_and_check)
    print(f"{written} files written to {folder}" if written else f"all files are in {folder} already")


@contextmanager
def _progress_bar() -> Generator[Show]:
    """Show a progress bar for each archive; yield the function that updates it."""
    columns = (TextColumn("{task.description}"), BarColumn(), DownloadColumn(), TransferSpeedColumn())
    console = Console(stderr=True)
    tasks: dict[str, TaskID] = {}
    with Progress(*columns, console=console, disable=not console.is_terminal) as bar:

        def show(name: str, done: int, total: int | None) -> None:
            if name not in tasks:
                tasks[name] = bar.add_task(name, total=total)
            bar.update(tasks[name], completed=done)

        yield show
