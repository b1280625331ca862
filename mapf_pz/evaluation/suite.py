"""Suites: lists of evaluation tasks in JSON files, either bundled with the package or written by users."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from importlib import resources
from pathlib import Path
from reprlib import repr as shortened
from typing import Annotated, Any, cast

from pydantic import AfterValidator, BeforeValidator, Field

from mapf_pz._internal.config import Count, Items, Natural, as_tuple, checked, expecting
from mapf_pz._internal.json import MAX_NAME, MAX_NUMBER, JsonObject, list_member, named_file, parse_object, whole_number
from mapf_pz._internal.plugins import NAMED_PARTS, check_trusted
from mapf_pz._internal.suggest import closest
from mapf_pz._internal.text import read_text
from mapf_pz.errors import FormatError
from mapf_pz.evaluation.identity import suite_digest
from mapf_pz.evaluation.task import EvaluationTask
from mapf_pz.evaluation.tracker import known_cost
from mapf_pz.guidance.library import is_guidance_file
from mapf_pz.instances import RandomObstacles, load_map, load_pogema, load_problem, load_scenario
from mapf_pz.instances.instance import Instance
from mapf_pz.instances.library import benchmark_file
from mapf_pz.simulator.config import EnvConfig

MAX_CELLS = 2**24
"""Maximum number of cells of a random map."""
MAX_TASKS = 1000
"""Maximum number of tasks."""
_MEMBERS = ("description", "version", "digest", "tasks")


def _line(text: str) -> str:
    if not 0 < len(text) <= MAX_NAME or not text.isprintable():
        raise ValueError("expected a single line of text")
    return text


def _of_few_cells(value: tuple[int, int, float]) -> tuple[int, int, float]:
    if value[0] * value[1] > MAX_CELLS:
        raise ValueError
    return value


Line = Annotated[str, AfterValidator(_line)]
"""A name or a file."""
Limited = Annotated[Count, Field(le=MAX_NUMBER)]
"""A whole number from 1 to `MAX_NUMBER`."""
RandomMap = Annotated[
    tuple[Limited, Limited, Annotated[int | float, Field(ge=0, lt=1)]],
    AfterValidator(_of_few_cells),
    BeforeValidator(as_tuple),
    expecting(f"[rows, columns, obstacle density], with at most {MAX_CELLS} cells"),
]
"""Rows, columns and obstacle density, with at most `MAX_CELLS` cells."""
BestThroughput = Annotated[int | float, Field(gt=0, le=MAX_NUMBER), expecting("a number greater than 0")]
"""A throughput, which keeps its type in the digest of the suite."""
NumAgents = Annotated[
    Limited | Annotated[Items[Limited], Field(min_length=1)],
    expecting("a whole number, 1 or more, or a list of such numbers"),
]
"""A number of agents, or several numbers."""


@checked
@dataclass(frozen=True)
class TaskEntry:
    """An entry of a suite file: a task, or one task for each of several numbers of agents.

    Exactly one of `map`, `random`, `pogema` and `lorr` determines the instances. Names are those of bundled data. Files
    are searched first in the folder of the suite file, then in the folders of the environment variable
    `MAPF_PZ_BENCHMARK`, then among downloads.
    """

    map: Line | None = None
    """Name of a map, or path of a `.map` or `.json` file. Starts and goals are random unless there are `scenarios`."""
    scenarios: Annotated[Items[Line], Field(min_length=1)] | None = None
    """Names or `.scen` files of scenarios, one for each episode; names such as `random-1` are relative to the map."""
    random: RandomMap | None = None
    """Rows, columns, and obstacle density of random maps."""
    pogema: Line | None = None
    """Name of instances of POGEMA's benchmark, such as `pogema-mazes`, or a file such as `mine.mapf.json`."""
    lorr: Line | None = None
    """Name of a League of Robot Runners problem, such as `warehouse_small_10`, or its JSON file; its `teamSize` is the
    number of agents."""
    num_agents: NumAgents | None = None
    """Number of agents, or a list of numbers; not given with `lorr`."""
    max_steps: Limited = EnvConfig.max_steps
    """Time limit of an episode in steps."""
    episodes: Limited | None = None
    """Number of episodes. None: one for each instance, or 64 if instances are random."""
    seed: Annotated[Natural, Field(le=MAX_NUMBER)] = EvaluationTask.seed
    """Seed of the first episode; it increases by one per episode."""
    name: Line | None = None
    """Name of the task, without the number of agents. None: the name of the map or file."""
    best: BestThroughput | None = None
    """Best known throughput."""
    env: JsonObject = field(default_factory=dict)
    """Other keyword arguments of `parallel_env`. The file of `edge_weights` is searched like the others."""

    def __post_init__(self) -> None:
        """Check which members are given together."""
        for name in self.env:
            if name not in _ENV_KEYWORDS:
                raise ValueError(f"env: expected one of {', '.join(_ENV_KEYWORDS)}, got {shortened(name)}")
        kinds = [kind for kind in _KINDS if getattr(self, kind) is not None]
        if len(kinds) != 1:
            raise ValueError(f"expected exactly one of {', '.join(_KINDS)}, got {' and '.join(kinds) or 'none'}")
        if self.scenarios is not None and self.map is None:
            raise ValueError("expected 'scenarios' only together with 'map'")
        if (self.num_agents is None) != (self.lorr is not None):
            raise ValueError("expected 'num_agents', except with 'lorr', where the problem determines it")


def suite_names() -> list[str]:
    """Return the names of the bundled suites, sorted."""
    return sorted(file.stem for file in _bundled().glob("*.json"))


def load_suite(suite: str | Path, trust_remote_code: bool = False) -> tuple[EvaluationTask, ...]:
    """Return the tasks of a suite.

    Args:
        suite: one of `suite_names()`, or the path of a `.json` file. The tasks of a suite with a version state it in
            their field `suite`.
        trust_remote_code: whether the file may name code outside this package.

    Raises:
        FileNotFoundError: the file, or a file that it refers to, does not exist.
        FormatError: the file, or a file that it refers to, is malformed, or names code without `trust_remote_code`;
            or the suite has another digest than its file says.
        ValueError: there is no suite of that name.
    """
    file = suite_file(suite)
    data = parse_object(read_text(file), file)
    for name in data:
        if name not in _MEMBERS:
            raise FormatError(file, f"expected one of {', '.join(_MEMBERS)}, got {shortened(name)}")
    entries = list_member(data, "tasks", file, least=1)
    _check_count(entries, file)
    tasks = [task for number, entry in enumerate(entries) for task in _tasks(entry, number, file, trust_remote_code)]
    names = [task.label for task in tasks]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise FormatError(file, f"expected unique task names ('name'), got {twice!r} twice")
    label = _label(tasks, data, file)
    return tuple(replace(task, suite=label) for task in tasks)


def _check_count(entries: Sequence[Any], file: Path) -> None:
    """Raise `FormatError` if there are too many tasks, before any of them is loaded."""
    counts = [entry.get("num_agents") if isinstance(entry, dict) else None for entry in entries]
    total = sum(len(count) if isinstance(count, list) else 1 for count in counts)
    if total > MAX_TASKS:
        raise FormatError(file, f"expected at most {MAX_TASKS} tasks, got {total}")


@cache
def suite_label(name: str) -> str:
    """Return the name, version and digest of a bundled suite; raises `ValueError` if there is no suite of that name."""
    file = suite_file(name)
    data = parse_object(read_text(file), file)
    return f"{name}/{data['version']} {data['digest']}"


def suite_file(suite: str | Path) -> Path:
    """Return the file of a suite by name or path; raises `ValueError` for an unknown name."""
    if str(suite).endswith(".json"):
        return Path(suite)
    if str(suite) in suite_names():
        return _bundled() / f"{suite}.json"
    near, names = closest(str(suite), suite_names()), ", ".join(suite_names())
    raise ValueError(f"suite {str(suite)!r}: {near}expected a .json file, or one of {names}")


def _label(tasks: Sequence[EvaluationTask], data: JsonObject, file: Path) -> str:
    """Return the name, version and digest of a suite, or an empty text if it has no version; checks its digest."""
    version, stated = data.get("version"), data.get("digest")
    if version is None:
        if stated is not None:
            raise FormatError(file, "expected 'digest' only together with 'version'")
        return ""
    whole_number(data, "version", file, least=1)
    found = suite_digest(tasks)
    if found is None:
        raise FormatError(file, "expected no 'version', since a part of a task has no digest")
    if stated is not None and stated != found:
        expected = f"expected the digest {shortened(stated)} of version {version}, got {found!r}"
        raise FormatError(file, f"{expected}: a changed suite needs another version")
    return f"{file.stem}/{version} {found}"


def _tasks(data: Any, number: int, file: Path, trust_remote_code: bool) -> list[EvaluationTask]:
    """Return the tasks of an entry, one for each number of agents."""
    where = f"{file}: task {number}"
    entry = _entry(data, where)
    check_trusted(where, {name: entry.env.get(name) for name in NAMED_PARTS}, trust_remote_code)
    make = next(make for kind, make in _KINDS.items() if getattr(entry, kind) is not None)
    counts = entry.num_agents if isinstance(entry.num_agents, tuple) else (entry.num_agents or 0,)
    try:
        weights = entry.env.get("edge_weights")
        if is_guidance_file(weights):
            entry = replace(entry, env=entry.env | {"edge_weights": _find(str(weights), "edge_weights", file.parent)})
        return [make(entry, count, file.parent) for count in counts]
    except FormatError:
        raise
    except FileNotFoundError as error:
        raise FileNotFoundError(f"{where}: {error}") from None
    except (ValueError, TypeError, RecursionError) as error:
        raise FormatError(where, str(error)) from None


def _entry(data: Any, where: str) -> TaskEntry:
    if not isinstance(data, dict):
        raise FormatError(where, f"expected an object, got {shortened(data)}")
    try:
        return TaskEntry(**{name: value for name, value in data.items() if value is not None})
    except (ValueError, TypeError) as error:
        raise FormatError(where, str(error)) from None


_ENV_KEYWORDS = [
    field.name
    for field in dataclasses.fields(EnvConfig)
    if field.name not in ("map", "scenario", "source", "num_agents", "max_steps", "render_mode")
]
"""The keyword arguments of `parallel_env` that have no member of an entry."""


def _of_map(entry: TaskEntry, num_agents: int, folder: Path) -> EvaluationTask:
    """Return a task on one map, with random instances or scenarios."""
    name = cast("str", entry.map)
    map = _find(name, "map", folder) if name.endswith((".map", ".json")) else name
    grid = load_map(map)
    if entry.scenarios is None:
        keywords = {"map": map if "goals" in entry.env else grid, "num_agents": num_agents}
        return _task(entry, grid.name, num_agents, keywords)
    instances: list[Instance] = []
    names: list[str] = []
    best_costs: list[int | None] = []
    for name in entry.scenarios:
        source = _find(name, "scenarios", folder) if name.endswith(".scen") else f"{grid.name}-{name}"
        scenario = load_scenario(source, grid)
        if len(scenario) < num_agents:
            raise ValueError(f"scenario {name!r}: expected {num_agents} agents, got {len(scenario)}")
        instances.append(Instance(grid, scenario.first(num_agents)))
        names.append(Path(source).stem)
        best_costs.append(known_cost(Path(source).stem, num_agents).best)
    return _task(entry, grid.name, num_agents, {}, instances, names).with_(best_costs=tuple(best_costs))


def _of_random(entry: TaskEntry, num_agents: int, _: Path) -> EvaluationTask:
    """Return a task on random maps."""
    height, width, density = cast("tuple[int, int, float]", entry.random)
    source = RandomObstacles(height, width, density, num_agents)
    return _task(entry, f"random {height} x {width}, {100 * density:g} % obstacles", num_agents, {"source": source})


def _of_pogema(entry: TaskEntry, num_agents: int, folder: Path) -> EvaluationTask:
    """Return a task on POGEMA's instances."""
    source = _named(cast("str", entry.pogema), "pogema", folder)
    name = Path(source).name.removesuffix(".json")
    return _task(entry, name, num_agents, {}, load_pogema(source, num_agents))


def _of_lorr(entry: TaskEntry, _: int, folder: Path) -> EvaluationTask:
    """Return a lifelong task of a League of Robot Runners problem."""
    source = _named(cast("str", entry.lorr), "lorr", folder)
    instance = load_problem(source).instance(entry.max_steps)  # no robot can reach more than one goal per step
    if entry.env.get("action_model") == "cardinal":
        instance = Instance(instance.grid, instance.scenario, delays=instance.delays)
    return _task(entry, Path(source).stem, instance.num_agents, {"on_target": "restart"}, [instance])


_KINDS = {"map": _of_map, "random": _of_random, "pogema": _of_pogema, "lorr": _of_lorr}
"""The functions that make a task, by the kind of entry."""


def _task(
    entry: TaskEntry,
    default_name: str,
    num_agents: int,
    keywords: dict[str, Any],
    instances: Sequence[Instance] = (),
    names: Sequence[str] = (),
) -> EvaluationTask:
    EnvConfig(num_agents=num_agents, **entry.env)  # rejects invalid values
    return EvaluationTask(
        name=entry.name or default_name,
        num_agents=num_agents,
        keywords={"max_steps": entry.max_steps} | keywords | entry.env,
        episodes=entry.episodes or len(instances) or 64,
        seed=entry.seed,
        instances=tuple(instances),
        instance_names=tuple(names),
        best=entry.best,
    )


def _named(source: str, member: str, folder: Path) -> str | Path:
    """Return the path of a `.json` file that a member names; anything else is a name."""
    return _find(source, member, folder) if source.endswith(".json") else source


def _find(file: str, member: str, folder: Path) -> Path:
    """Return the path of a file that a member names, in the suite's folder or in the folders of benchmark data."""
    local = named_file(file, member, folder, folder)
    return local if os.path.isfile(local) else benchmark_file(file)


def _bundled() -> Path:
    return Path(str(resources.files("mapf_pz.evaluation"))) / "suites"
