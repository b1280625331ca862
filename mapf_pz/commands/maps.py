"""The command `mapf-pz maps`: list maps, write the bundled ones, generate or convert others, download the benchmark."""

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
from mapf_pz.instances import (
    MapMixture,
    convert_pogema,
    load_problem,
    map_names,
    read_map,
    write_bundled,
    write_map,
    write_scenario,
)
from mapf_pz.instances.benchmarks.lorr import problem_names
from mapf_pz.instances.benchmarks.movingai import NUM_SCENARIOS, scenario_maps
from mapf_pz.instances.benchmarks.pogema import instance_keys, instance_names
from mapf_pz.instances.download import Show, cache_folder, download
from mapf_pz.instances.files.archive import ARCHIVES, MAPS
from mapf_pz.instances.library import map_paths
from mapf_pz.simulator.config import DEFAULT_NUM_AGENTS


@dataclass(frozen=True)
class ListMaps:
    """List all names: bundled and downloaded maps, maps to download, bundled problems and POGEMA's instances."""


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


@dataclass(frozen=True)
class ConvertMaps:
    """Convert a configuration of POGEMA's benchmark to instances, as POGEMA 1.4.0 samples them from its seeds."""

    config: Positional[Path]
    """Configuration of the benchmark, a YAML file with maps' names, seeds and numbers of agents."""
    folder: Positional[Path]
    """Output folder, which is created if necessary."""
    maps: Path | None = None
    """YAML file with the drawings of the maps. Default: `maps.yaml` beside the configuration."""


def maps(
    task: Annotated[ListMaps, subcommand("list")]
    | Annotated[WriteMaps, subcommand("write")]
    | Annotated[GenerateMaps, subcommand("generate")]
    | Annotated[ConvertMaps, subcommand("convert")]
    | Annotated[DownloadMaps, subcommand("download")],
) -> None:
    """List maps, write the bundled ones, generate or convert others, or download the benchmark."""
    match task:
        case ListMaps():
            _list()
        case WriteMaps(folder):
            print(f"{len(write_bundled(folder))} maps written to {folder}")
        case GenerateMaps():
            _generate(task)
        case ConvertMaps(config, folder, drawings):
            for file in convert_pogema(config, drawings or config.with_name("maps.yaml"), folder):
                print(f"{file} written")
        case DownloadMaps(scenarios, folder):
            _download(scenarios, folder or cache_folder())


def _list() -> None:
    """Print a line for each name, of which the last part says where its data is."""
    lines = {name: _described(file, name) for name, file in map_paths().items()}
    lines |= {name: "map of the MovingAI benchmark, mapf-pz maps download" for name in MAPS if name not in lines}
    for name in problem_names():
        problem = load_problem(name)
        lines[name] = f"problem of the League of Robot Runners 2023, {problem.team_size} agents, bundled"
    for name in instance_names():
        lines[name] = f"{len(instance_keys(name))} instances of POGEMA's benchmark, bundled"
    for name, text in lines.items():
        print(f"{name:{max(map(len, lines))}}  {text}")


def _described(file: Path, name: str) -> str:
    """Return the size of a map, and where it and its scenarios are."""
    grid = read_map(file)
    place = "bundled" if name in map_names() else str(file.parent)
    scenarios = f", scenarios random-1 to random-{NUM_SCENARIOS}" if name in scenario_maps() else ""
    return f"{grid.shape[0]:4} x {grid.shape[1]:<4} {grid.free.sum():6} free cells, {place}{scenarios}"


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
