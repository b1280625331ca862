"""Suites: lists of trials in small JSON files, those that come with the package and those that users write."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from reprlib import repr as shortened
from typing import Any

from mapf_pz.config import EnvConfig
from mapf_pz.evaluate.trial import Trial
from mapf_pz.instances import RandomObstacles, load_map, load_problem, load_scenario
from mapf_pz.instances.jsonfile import JsonObject, is_whole, list_member, parse_object
from mapf_pz.instances.library import benchmark_file
from mapf_pz.instances.pogema import load_pogema
from mapf_pz.instances.textfile import read_text
from mapf_pz.types import FormatError, Instance, Scenario


@dataclass(frozen=True)
class Entry:
    """One of the entries of a suite's file: a trial, or one for each of several numbers of agents.

    Exactly one of `map`, `random`, `pogema` and `lorr` says where episodes come from. Files are sought beside the
    suite's own file first, then in the folders that the variable `MAPF_PZ_BENCHMARK` names.
    """

    map: str | None = None
    """A map's name, or the path of a `.map` file; episodes are drawn, unless there are `scenarios`."""
    scenarios: list[str] | None = None
    """Names or `.scen` files, one for each episode; `random-1` is that of the map."""
    random: list[float] | None = None
    """Rows, columns, and share of obstacles of random maps."""
    pogema: str | None = None
    """A file of POGEMA's benchmark, `01-random.mapf.json`."""
    lorr: str | None = None
    """The JSON file of a League of Robot Runners problem; its `teamSize` is the number of agents."""
    num_agents: int | list[int] = 0
    """N, or several."""
    max_steps: int = EnvConfig.max_steps
    """Time limit."""
    episodes: int | None = None
    """How many; None: one for each instance, or 64 where they are drawn."""
    seed: int = Trial.seed
    """Of the first episode; the others follow by ones."""
    about: str | None = None
    """What the trial is about, all but the number of agents; None: the map's name or the file's."""
    best: float | None = None
    """The best throughput known."""
    env: JsonObject = field(default_factory=dict)
    """Other keywords of `parallel_env`."""


def suite_names() -> list[str]:
    """Return the names of the suites that come with the package, sorted."""
    return sorted(file.stem for file in _bundled().glob("*.json"))


def load_suite(suite: str | Path) -> tuple[Trial, ...]:
    """Return the trials of a suite: one of `suite_names()`, or the path of a `.json` file.

    Raises:
        FileNotFoundError: There is no such file, or one that the suite names is absent.
        FormatError: The file is malformed, or names one that is.
        ValueError: There is no suite of that name.
    """
    if str(suite).endswith(".json"):
        file = Path(suite)
    elif suite in suite_names():
        file = _bundled() / f"{suite}.json"
    else:
        raise ValueError(f"suite {str(suite)!r}: expected a .json file, or one of {', '.join(suite_names())}")
    entries = list_member(parse_object(read_text(file), file), "trials", file, least=1)
    trials = [trial for number, entry in enumerate(entries) for trial in _trials(entry, number, file)]
    names = [trial.name for trial in trials]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise FormatError(file, f"expected trials of different names ('about'), got {twice!r} twice")
    return tuple(trials)


def _trials(data: Any, number: int, file: Path) -> list[Trial]:
    """Return the trials of an entry, one for each number of agents."""
    where = f"{file}: trial {number}"
    entry = _entry(data, where)
    make = next(make for kind, make in _KINDS.items() if getattr(entry, kind) is not None)
    counts = entry.num_agents if isinstance(entry.num_agents, list) else [entry.num_agents]
    try:
        return [make(entry, count, file.parent) for count in counts]
    except FormatError:
        raise
    except (ValueError, TypeError) as error:
        raise FormatError(where, str(error)) from None


def _entry(data: Any, where: str) -> Entry:
    if not isinstance(data, dict):
        raise FormatError(where, f"expected an object, got {shortened(data)}")
    known = [field.name for field in dataclasses.fields(Entry)]
    for name in data:
        if name not in known:
            raise FormatError(where, f"expected one of {', '.join(known)}, got {name!r}")
    if not isinstance(data.get("env", {}), dict):
        raise FormatError(where, f"expected 'env' to be an object, got {shortened(data['env'])}")
    entry = Entry(**data)
    kinds = [kind for kind in _KINDS if getattr(entry, kind) is not None]
    if len(kinds) != 1:
        raise FormatError(where, f"expected exactly one of {', '.join(_KINDS)}, got {' and '.join(kinds) or 'none'}")
    counts = entry.num_agents if isinstance(entry.num_agents, list) else [entry.num_agents]
    for name, values in {"num_agents": counts, "max_steps": [entry.max_steps], "seed": [entry.seed]}.items():
        least = 1 if name != "seed" and entry.lorr is None else 0
        if not values or not all(is_whole(value) and value >= least for value in values):
            raise FormatError(where, f"expected {name!r} to be a whole number, {least} or more")
    if entry.episodes is not None and not (is_whole(entry.episodes) and entry.episodes > 0):
        raise FormatError(
            where, f"expected 'episodes' to be a whole number, 1 or more, got {shortened(entry.episodes)}"
        )
    return entry


def _of_map(entry: Entry, num_agents: int, folder: Path) -> Trial:
    """Return a trial on one map, with drawn episodes or scenarios."""
    name = str(entry.map)
    grid = load_map(_found(name, folder) if name.endswith(".map") else name)
    if entry.scenarios is None:
        return _trial(entry, grid.name, num_agents, {"map": grid, "num_agents": num_agents})
    instances: list[Instance] = []
    for told in entry.scenarios:
        scenario = load_scenario(_found(told, folder) if told.endswith(".scen") else f"{grid.name}-{told}", grid)
        if len(scenario) < num_agents:
            raise ValueError(f"scenario {told!r}: expected {num_agents} agents, got {len(scenario)}")
        instances.append(Instance(grid, Scenario(scenario.starts[:num_agents], scenario.goals[:num_agents])))
    return _trial(entry, grid.name, num_agents, {}, instances)


def _of_random(entry: Entry, num_agents: int, _: Path) -> Trial:
    """Return a trial on random maps."""
    if not isinstance(entry.random, list) or len(entry.random) != 3:
        raise ValueError(f"random: expected [rows, columns, share of obstacles], got {shortened(entry.random)}")
    height, width, density = entry.random
    source = RandomObstacles(int(height), int(width), density, num_agents)
    return _trial(entry, f"random {height} x {width}, {100 * density:g} % obstacles", num_agents, {"source": source})


def _of_pogema(entry: Entry, num_agents: int, folder: Path) -> Trial:
    """Return a trial of POGEMA's instances."""
    file = _found(str(entry.pogema), folder)
    return _trial(entry, file.name.removesuffix(".json"), num_agents, {}, load_pogema(file, num_agents))


def _of_lorr(entry: Entry, _: int, folder: Path) -> Trial:
    """Return a trial of a League of Robot Runners problem, whose robots have goals one after the other."""
    file = _found(str(entry.lorr), folder)
    instance = load_problem(file).instance(entry.max_steps)  # no robot can reach more than one goal a step
    if entry.env.get("action_model") == "cardinal":
        instance = Instance(instance.grid, instance.scenario)
    return _trial(entry, file.stem, instance.num_agents, {"on_target": "restart"}, [instance])


_KINDS = {"map": _of_map, "random": _of_random, "pogema": _of_pogema, "lorr": _of_lorr}
"""What makes a trial of each kind of entry."""


def _trial(
    entry: Entry, about: str, num_agents: int, keywords: dict[str, Any], instances: list[Instance] | None = None
) -> Trial:
    return Trial(
        family=entry.about or about,
        num_agents=num_agents,
        keywords={"max_steps": entry.max_steps} | keywords | entry.env,
        episodes=entry.episodes or (len(instances) if instances else 64),
        seed=entry.seed,
        instances=tuple(instances or ()),
        best=entry.best,
    )


def _found(name: str, folder: Path) -> Path:
    """Return a file that a suite names: beside the suite's own file, or in the folders of benchmark data."""
    beside = folder / name
    return beside if beside.is_file() else benchmark_file(name)


def _bundled() -> Path:
    return Path(str(resources.files("mapf_pz.evaluate"))) / "suites"
