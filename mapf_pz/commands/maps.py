"""The command `mapf-pz maps`: list or write the bundled maps, generate new ones, or download the benchmark."""

from __future__ import annotations

import logging
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, DownloadColumn, Progress, TaskID, TextColumn, TransferSpeedColumn
from tyro.conf import Positional, subcommand

from mapf_pz._internal.interrupts import interruptible
from mapf_pz._internal.lock import locked
from mapf_pz.instances import MapMixture, load_map, map_names, write_bundled, write_map, write_scenario
from mapf_pz.instances.download import Show, cache_folder, download
from mapf_pz.instances.files.archive import ARCHIVES
from mapf_pz.simulator.config import DEFAULT_NUM_AGENTS


@dataclass(frozen=True)
class ListMaps:
    """List the bundled maps: name, rows x columns, free cells."""


@dataclass(frozen=True)
class WriteMaps:
    """Write the files of the bundled maps."""

    folder: Positional[Path]
    """Output folder, which is created if necessary."""


@dataclass(frozen=True)
class GenerateMaps:
    """Generate maps with scenarios: files `NUMBER-NAME.map` and `NUMBER-NAME.scen`."""

    folder: Positional[Path]
    """Output folder, which is created if necessary."""
    mixture: MapMixture = field(default_factory=MapMixture)
    """The families of the maps; smaller maps are padded with obstacles to the size of the largest."""
    num_agents: int | None = None
    """Number of agents of each scenario. Default: 4."""
    number: int = 10
    """Number of maps."""
    seed: int = 0
    """Random seed."""


@dataclass(frozen=True)
class DownloadMaps:
    """Download the MovingAI benchmark, so that its maps and scenarios are available by name."""

    scenarios: Literal["random", "even", "both"] = "both"
    """Scenarios to download. `random`: random goals; `even`: evenly distributed distances; `both`."""
    folder: Path | None = None
    """Output folder, to which `MAPF_PZ_BENCHMARK` must be set. None: the user's cache, or `MAPF_PZ_CACHE`."""


def maps(
    task: Annotated[ListMaps, subcommand("list")]
    | Annotated[WriteMaps, subcommand("write")]
    | Annotated[GenerateMaps, subcommand("generate")]
    | Annotated[DownloadMaps, subcommand("download")],
) -> None:
    """List or write the bundled maps, generate new ones, or download the benchmark."""
    match task:
        case ListMaps():
            _list()
        case WriteMaps(folder):
            print(f"{len(write_bundled(folder))} maps written to {folder}")
        case GenerateMaps():
            _generate(task)
        case DownloadMaps(scenarios, folder):
            _download(scenarios, folder or cache_folder())


def _list() -> None:
    names = map_names()
    for name in names:
        grid = load_map(name)
        print(f"{name:{max(map(len, names))}} {grid.shape[0]:4} x {grid.shape[1]:<4} {grid.free.sum():6} free cells")


def _generate(options: GenerateMaps) -> None:
    num_agents = DEFAULT_NUM_AGENTS if options.num_agents is None else options.num_agents
    for name, value, least in (("num_agents", num_agents, 1), ("number", options.number, 1), ("seed", options.seed, 0)):
        if value < least:
            raise ValueError(f"{name}={value}: expected {least} or more")
    source, rng = options.mixture.source(num_agents), np.random.default_rng(options.seed)
    with locked(options.folder):
        for number in range(1, options.number + 1):
            instance = source.sample(rng)
            file = options.folder / f"{number}-{instance.grid.name}.map"
            write_map(instance.grid, file)
            write_scenario(instance.scenario, replace(instance.grid, name=file.stem), file.with_suffix(".scen"))
    print(f"{options.number} maps with scenarios written to {options.folder}")


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
