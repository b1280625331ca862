"""Configurations of POGEMA's benchmark, in YAML, and their conversion to the files that `read_pogema` reads.

A configuration lists maps by name, seeds and numbers of agents; `maps.yaml` beside it draws the maps. Source:
github.com/Cognitive-AI-Systems/pogema-benchmark.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from itertools import product
from pathlib import Path
from reprlib import repr as shortened
from typing import Any

import numpy as np

from mapf_pz._internal.atomic import write_whole
from mapf_pz._internal.json import JsonObject, are_whole
from mapf_pz._internal.text import read_text
from mapf_pz.errors import FormatError
from mapf_pz.instances.files.movingai import parse_cells
from mapf_pz.instances.files.pogema import BLOCKED, MAX_GOALS, PASSABLE
from mapf_pz.instances.pogema_placement import Cell, PogemaMap, place_agents

MAX_BYTES = 2**22
"""Maximum size of a YAML file."""
MAX_DEPTH, MAX_ALIASES = 20, 100
"""Maximum depth of nesting, and number of aliases, in a YAML file."""
LIFELONG_STEPS = 300
"""Number of steps that sequences of lifelong goals cover: more than an episode of the benchmark has."""


def convert_pogema(config: str | Path, maps: str | Path, folder: str | Path) -> list[Path]:
    """Convert a configuration to instances: `NAME.maps.json`, and `NAME.mapf.json` or, lifelong, `NAME.lmapf.json`.

    There is an instance for each of its maps and seeds, with as many agents as its largest number. Starts and goals are
    those that POGEMA 1.4.0 samples; instances that the configuration itself states (`scenarios`) are ignored.

    Args:
        config: the configuration, `NAME.yaml`, `NAME-mapf.yaml` or `NAME-lmapf.yaml`.
        maps: the file that draws the maps.
        folder: the folder of the converted files, which is created if necessary.

    Returns:
        The files.

    Raises:
        FileNotFoundError: a file does not exist.
        FormatError: a file is malformed, or a map has too few cells for the agents.
        ImportError: PyYAML is not installed.
    """
    settings = _mapping(_read_yaml(Path(config)).get("environment"), "environment", config)
    names = _values(settings, "map_name", config)
    seeds, counts = (_values(settings, name, config) for name in ("seed", "num_agents"))
    if not are_whole(seeds) or not are_whole(counts) or min(counts) < 1:
        raise FormatError(
            config, "expected 'seed' and 'num_agents' to be whole numbers, or 'grid_search' lists of them"
        )
    num_steps = LIFELONG_STEPS if settings.get("on_target") == "restart" else 0
    num_agents = max(counts)
    if len(names) * len(seeds) * num_agents * (num_steps + 1) > MAX_GOALS:
        raise FormatError(config, f"expected at most {MAX_GOALS} goals in all instances")
    drawings = _read_yaml(Path(maps))
    drawn = {name: _rows(drawings, name, maps) for name in dict.fromkeys(names)}
    parsed = {name: _map(rows, f"{maps}: map {shortened(name)}") for name, rows in drawn.items()}
    entries: list[JsonObject] = []
    for seed, name in product(seeds, names):
        try:
            starts, goals = place_agents(parsed[name], num_agents, seed, num_steps)
        except ValueError as error:
            raise FormatError(config, f"map {shortened(name)}, seed {seed}: {error}") from None
        targets: list[Any] = goals if num_steps else [sequence[0] for sequence in goals]
        entry = {"map_name": name, "seed": seed, "num_agents": num_agents, "agents_xy": starts, "targets_xy": targets}
        entries.append(entry)
    stem = Path(config).stem.removesuffix("-lmapf").removesuffix("-mapf")
    kind = "lmapf" if num_steps else "mapf"
    files = Path(folder) / f"{stem}.maps.json", Path(folder) / f"{stem}.{kind}.json"
    Path(folder).mkdir(parents=True, exist_ok=True)
    for file, content in zip(files, (drawn, entries), strict=True):
        write_whole(file, json.dumps(content).encode())
    return list(files)


def _read_yaml(file: Path) -> JsonObject:
    """Return the members of a YAML file."""
    try:
        import yaml
    except ImportError as error:
        raise ImportError("POGEMA's configurations require PyYAML: pip install 'mapf-pz[pogema]'") from error
    text = read_text(file, MAX_BYTES)
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    try:
        _check_events(yaml.parse(text, loader), file)
        content = yaml.load(text, loader)
    except FormatError:
        raise
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        problem = getattr(error, "problem", None) or "it cannot be read"
        raise FormatError(file, f"expected YAML: {problem}", 0 if mark is None else mark.line + 1) from None
    except (RecursionError, ValueError):
        raise FormatError(file, "expected YAML of numbers and text that is not nested deeply") from None
    return _mapping(content, "the file", file)


def _check_events(events: Iterable[Any], file: Path) -> None:
    """Raise `FormatError` unless the events of YAML's parser make a small object.

    Loading deeply nested lists overflows the stack, and each merge key (`<<`) copies the members of what it merges.
    """
    from yaml import AliasEvent, CollectionEndEvent, CollectionStartEvent, ScalarEvent

    depth = aliases = 0
    for event in events:
        depth += isinstance(event, CollectionStartEvent) - isinstance(event, CollectionEndEvent)
        aliases += isinstance(event, AliasEvent)
        is_merge = isinstance(event, ScalarEvent) and event.value == "<<" and event.implicit[0]
        if depth > MAX_DEPTH or aliases > MAX_ALIASES or is_merge:
            limits = f"at most {MAX_DEPTH} levels and {MAX_ALIASES} aliases, and no merge keys"
            raise FormatError(file, f"expected YAML with {limits}", event.start_mark.line + 1)


def _mapping(value: Any, name: str, origin: str | Path) -> JsonObject:
    if not isinstance(value, dict):
        raise FormatError(origin, f"expected {name} to be a mapping, got {shortened(value)}")
    return value


def _values(settings: JsonObject, name: str, origin: str | Path) -> list[Any]:
    """Return the values of a setting: one, or those of its `grid_search`."""
    value = settings.get(name)
    values = value.get("grid_search") if isinstance(value, dict) else [value]
    if not isinstance(values, list) or not values or not all(isinstance(one, (str, int)) for one in values):
        raise FormatError(origin, f"expected {name!r} to have a value or a 'grid_search' list, got {shortened(value)}")
    return values


def _rows(maps: JsonObject, name: str, origin: str | Path) -> list[str]:
    """Return the rows of a map."""
    drawing = maps.get(name)
    if not isinstance(drawing, str) or not drawing.split():
        raise FormatError(origin, f"expected a drawing of the map {shortened(name)}, got {shortened(drawing)}")
    return drawing.split()


def _map(rows: list[str], where: str) -> PogemaMap:
    """Return a map with its marked cells: agents start on `@`, and goals are on `$`; both may be on `.`."""
    free = parse_cells(rows, len(rows[0]), where, 1, PASSABLE, BLOCKED)
    characters = np.array([list(row) for row in rows])
    starts, goals = _cells(np.isin(characters, ["@", "."])), _cells(np.isin(characters, ["$", "."]))
    if not np.isin(characters, ["@", "$", "!"]).any() or not starts or not goals:
        return PogemaMap(free)
    return PogemaMap(free, starts, goals)


def _cells(chosen: Any) -> tuple[Cell, ...]:
    return tuple((row, col) for row, col in np.argwhere(chosen).tolist())
