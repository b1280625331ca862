"""Loading of maps and scenarios by name, file, text drawing or array."""

from __future__ import annotations

import os
import re
import textwrap
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from mapf_pz._internal.arrays import Bools
from mapf_pz._internal.json import parse_object
from mapf_pz._internal.suggest import closest
from mapf_pz._internal.text import read_text
from mapf_pz.errors import FormatError
from mapf_pz.instances.benchmarks import movingai
from mapf_pz.instances.bundled import map_names, map_path
from mapf_pz.instances.download import cache_folder
from mapf_pz.instances.files.layout import PASSABLE, cells_of, layout_rows
from mapf_pz.instances.files.movingai import parse_cells, parse_map_name, read_map, read_scenario
from mapf_pz.instances.instance import Grid, Scenario

DEFAULT_MAP = "empty-8-8"
"""The map if no map, scenario or source is given."""
LAYOUT_ENDING = ".json"
"""Extension of maps of guidance graph optimization (GGO)."""
BENCHMARK_VARIABLE = "MAPF_PZ_BENCHMARK"
"""Environment variable with a list of folders of benchmark data, separated as in `PATH`, with `maps/` and `scens/`."""
ADVICE = (
    "for the files of the MovingAI benchmark, run mapf-pz maps download, or set "
    f"{BENCHMARK_VARIABLE} to a folder with its maps/ and scens/"
)
"""Advice in errors about unknown names."""
_RELATIVE = re.compile(r"(random|even)-\d+")
"""Names of scenarios that are relative to a map."""
_WHOLE = re.compile(rf"(.+)-{_RELATIVE.pattern}")
"""Whole names of scenarios."""


def load_map(map: str | Path | Bools | Grid) -> Grid:
    """Return the map specified by `map`.

    Args:
        map: One of these, checked in this order:
            a `Grid`, which is returned unchanged; a bool array (H, W), True where a cell is free;
            a `Path`: a file;
            a str with a newline: a text drawing, with `.` for free cells and any of `#@OTW` for obstacles; indentation
            and surrounding empty lines are ignored;
            a str that ends in `.map`: the path of a file; or in `.json`: the path of a GGO map;
            any other str: the name of a bundled map (`map_names()`), of one in the folder `$MAPF_PZ_BENCHMARK/maps`, or
            of one downloaded by `mapf-pz maps download`, searched in this order.

    Raises:
        FileNotFoundError: The file does not exist.
        FormatError: The file or the drawing is malformed.
        ValueError: The name is unknown, or the array is not two-dimensional.
        TypeError: `map` has another type.
    """
    if isinstance(map, Grid):
        return map
    if isinstance(map, str) and "\n" in map:
        return _parse_drawing(map)
    if isinstance(map, (str, Path)):
        file = map_file(map)
        return _read_layout(file) if str(file).endswith(LAYOUT_ENDING) else read_map(file)
    return Grid.from_array(map)


def map_file(map: str | Path) -> Path:
    """Return the file of a map by name or path, as in `load_map`; raises `ValueError` for an unknown name."""
    if str(map).endswith(LAYOUT_ENDING):
        return Path(map)
    if str(map) in map_names() and not isinstance(map, Path):
        return map_path(str(map))
    return _resolve(map, ".map", _benchmark("maps"), map_names())


def load_scenario(scenario: str | Path | Scenario, grid: Grid | None = None) -> Scenario:
    """Return the scenario specified by `scenario`.

    Args:
        scenario: A `Scenario`, which is returned unchanged; a `Path` or a str that ends in `.scen`: a file; any other
            str: the name of a bundled scenario, of one in the folder `$MAPF_PZ_BENCHMARK/scens`, or of a downloaded
            one, searched in this order: such as `den312d-random-1` or, relative to the map `grid`, `random-1`.
        grid: The map that a scenario must fit.

    Raises:
        FileNotFoundError: The file does not exist.
        FormatError: The file is malformed, or does not fit the map.
        ValueError: The name is unknown, is that of a scenario of another map, or the file is a problem file.
        TypeError: `scenario` has another type.
    """
    if isinstance(scenario, Scenario):
        return scenario
    if str(scenario).endswith(".json"):
        advice = "problem files are evaluated as 'lorr' or 'pogema' of a suite"
        raise ValueError(f"scenario={str(scenario)!r}: expected a .scen file of the map; {advice}")
    if not isinstance(scenario, str):
        return read_scenario(_scenario_file(scenario), grid)
    name = scenario_name(scenario, None if grid is None else grid.name)
    bundled = movingai.map_of(name)
    if bundled is None:
        return read_scenario(_scenario_file(name), grid)
    own = load_map(bundled)
    if grid is not None and not np.array_equal(own.free, grid.free):
        raise ValueError(f"scenario={name!r}: expected a scenario of map {grid.name!r}, got one of {bundled!r}")
    return movingai.read_scenario(name, own)


def scenario_name(scenario: str | Path, map: str | None) -> str:
    """Return the whole name or the path of a scenario, such as `den312d-random-1` for `random-1` of the map `den312d`.

    Raises `ValueError` for such a relative name without a map.
    """
    name = str(scenario)
    if isinstance(scenario, Path) or not _RELATIVE.fullmatch(name):
        return name
    if map is None:
        raise ValueError(f"scenario={name!r}: expected a map, too, or a whole name such as {f'den312d-{name}'!r}")
    return f"{map}-{name}"


def scenario_map(scenario: str | Path) -> str | Path:
    """Return the map that a scenario names: the file beside the scenario, otherwise its name, as in `load_map`.

    Only the last part of a path in a scenario is used, so that a file cannot name files outside its folder. The result
    is empty if the file names no map.

    Args:
        scenario: the path or the name of a scenario, as in `load_scenario`.

    Raises:
        FileNotFoundError: The file does not exist.
        ValueError: The name is unknown.
    """
    bundled = None if isinstance(scenario, Path) else movingai.map_of(scenario_name(scenario, None))
    if bundled is not None:
        return bundled
    file = _scenario_file(scenario)
    name = parse_map_name(read_text(file))
    beside = file.parent / f"{name}.map"
    return beside if os.path.isfile(beside) else name


def _scenario_file(scenario: str | Path) -> Path:
    return _resolve(scenario, ".scen", _benchmark("scens"), movingai.scenario_names())


def map_paths() -> dict[str, Path]:
    """Return the files of all maps that `load_map` finds by name: bundled ones, then those of the folders."""
    files = {name: map_path(name) for name in map_names()}
    for folder in _benchmark("maps"):
        for file in sorted(folder.glob("*.map")):
            files.setdefault(file.stem, file)
    return files


def scenario_names() -> dict[str, list[str]]:
    """Return the whole names of the scenarios that `load_scenario` finds by name, by map.

    They are the bundled ones, then those of the folders.
    """
    files = (file for folder in _benchmark("scens") for file in sorted(folder.glob("*.scen")))
    names: dict[str, list[str]] = {}
    for name in dict.fromkeys([*movingai.scenario_names(), *(file.stem for file in files)]):
        if whole := _WHOLE.fullmatch(name):
            names.setdefault(whole[1], []).append(name)
    return names


def benchmark_file(name: str) -> Path:
    """Return the file with this relative path in the folders of benchmark data; raises `FileNotFoundError`."""
    for file in _benchmark(name):
        if os.path.isfile(file):
            return file
    raise FileNotFoundError(f"no file {name!r} in the folders of benchmark data: {ADVICE}")


def _benchmark(name: str) -> Iterator[Path]:
    """Yield this relative path in each folder of benchmark data; the folder of downloads is the last."""
    for folder in os.environ.get(BENCHMARK_VARIABLE, "").split(os.pathsep):
        if folder:
            yield Path(folder) / name
    yield cache_folder() / name


def _resolve(source: object, ending: str, folders: Iterable[Path], bundled: Iterable[str]) -> Path:
    """Return the file for a path or a name; names are searched in `folders` in order. `bundled` are other names."""
    if isinstance(source, Path):
        return source
    if not isinstance(source, str):
        raise TypeError(f"expected a name or the path of a {ending} file, got {type(source).__name__}")
    if source.endswith(ending):
        return Path(source)
    names = list(bundled)
    for folder in folders:
        for file in sorted(folder.glob(f"*{ending}")):
            if file.stem == source:
                return file
            names.append(file.stem)
    raise ValueError(f"no {ending} file is named {source!r}: {closest(source, names)}A path ends in {ending}; {ADVICE}")


def _read_layout(path: Path) -> Grid:
    """Read the map in a GGO file."""
    data = parse_object(read_text(path), path)
    if "layout" not in data:
        raise FormatError(path, "expected a map with the member 'layout'; a problem's .json file is a scenario")
    return Grid(cells_of(layout_rows(data, path), PASSABLE), path.stem)


def _parse_drawing(text: str) -> Grid:
    """Parse a map drawn as text; line numbers in messages include leading empty lines."""
    lines = [line.rstrip() for line in textwrap.dedent(text).split("\n")]
    row_lines = [number for number, line in enumerate(lines) if line]
    if not row_lines:
        raise ValueError("map: the drawing is empty")
    first, last = row_lines[0], row_lines[-1]
    rows = lines[first : last + 1]
    return Grid(parse_cells(rows, len(rows[0]), "map", first + 1, passable=".", blocked="#@OTW"))
