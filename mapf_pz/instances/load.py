"""Loading of instances: from scenarios of a map, and from problem files that name their own maps."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from mapf_pz._internal.arrays import Bools, Ints
from mapf_pz._internal.suggest import expected_names
from mapf_pz.errors import FormatError
from mapf_pz.instances.benchmarks import lorr, pogema
from mapf_pz.instances.files.lorr import LorrProblem, read_problem
from mapf_pz.instances.files.pogema import read_pogema
from mapf_pz.instances.generate import on_canvas
from mapf_pz.instances.heading import Heading
from mapf_pz.instances.instance import ActionModel, Grid, HeadingName, Instance, Scenario
from mapf_pz.instances.library import DEFAULT_MAP, load_map, load_scenario, scenario_map
from mapf_pz.instances.place import check_reachable, place

PROBLEM_ENDING = ".json"
"""Extension of problem files, which name their own maps."""
POGEMA_ENDINGS = (".mapf.json", ".lmapf.json")
"""Extensions of POGEMA's files; other problem files are those of the League of Robot Runners."""


def load_instance(
    map: str | Path | Bools | Grid,
    scenario: str | Path | Scenario | None = None,
    num_agents: int | None = None,
    action_model: ActionModel = "rotate",
    headings: HeadingName | ArrayLike = "east",
    seed: int = 0,
) -> Instance:
    """Return the instance of a scenario's first agents on a map.

    Args:
        map: The map, as in `load_map`.
        scenario: The scenario, as in `load_scenario`; None samples starts and goals.
        num_agents: Number of agents; None: all agents of the scenario.
        action_model: `rotate`: agents have headings; `cardinal`: they do not.
        headings: Initial headings with `rotate`: `east`, `random`, or (N,) numbers 0 to 3 (`Heading`).
        seed: Random seed.

    Raises:
        FileNotFoundError: A file does not exist.
        FormatError: A file is malformed, or the scenario does not fit the map.
        ValueError: The scenario has too few agents, an agent cannot reach its goal, or a value is not allowed.
    """
    rng = np.random.default_rng(seed)
    grid = load_map(map)
    if num_agents is not None and num_agents < 1:
        raise ValueError(f"num_agents={num_agents}: expected a whole number, 1 or more")
    if scenario is not None:
        agents = load_scenario(scenario, grid)
        agents = agents.first(_count(num_agents, len(agents), _name(scenario)))
    elif num_agents is not None:
        agents = place(grid, num_agents, rng)
    else:
        raise ValueError("num_agents: expected a number, as there is no scenario")
    instance = Instance(grid, agents, sample_headings(headings, len(agents), rng) if action_model == "rotate" else None)
    check_reachable(instance)
    return instance


def load_instances(
    scenarios: Sequence[str | Path | Scenario],
    map: str | Path | Bools | Grid | None = None,
    num_agents: int | None = None,
    goals_per_agent: int = 1,
) -> list[Instance]:
    """Return the instances of one or more scenarios, all with the same map size and number of agents.

    If maps differ in size, they are placed in the upper left corner of a map of obstacles as large as the largest.

    Args:
        scenarios: Scenarios of one map, as in `load_scenario`; or problems, which name their own maps: `.mapf.json` and
            `.lmapf.json` of POGEMA's benchmark, each with several instances, `.json` of the League of Robot Runners,
            and names of bundled ones, as in `load_pogema` and `load_problem`.
        map: The map of the scenarios, as in `load_map`. None: the one that the scenarios' files name, in their folder
            or by name, or `empty-8-8` if all are `Scenario`s. Not allowed with problems.
        num_agents: Number of agents, the first of each instance; None: as many as the smallest instance has.
        goals_per_agent: Number of goals of each robot of a League of Robot Runners problem.

    Raises:
        FileNotFoundError: A file does not exist.
        FormatError: A file is malformed, or a scenario does not fit the map.
        ValueError: An instance has too few agents, an agent cannot reach a goal, or arguments contradict each other.
    """
    problems = [str(item) for item in scenarios if not isinstance(item, Scenario) and _is_problem(item)]
    if not problems:
        grid = load_map(_named_map(scenarios) if map is None else map)
        instances = [_of_scenario(item, grid, num_agents) for item in scenarios]
    elif map is not None:
        raise ValueError(f"map: not allowed with the scenario {problems[0]!r}, which names its own map")
    elif len(problems) < len(scenarios):
        raise ValueError(f"scenario: expected only problem files, such as {problems[0]!r}, or only scenarios of a map")
    else:
        instances = [instance for path in problems for instance in _of_problem(path, num_agents, goals_per_agent)]
    count = min(instance.num_agents for instance in instances)
    shape = max(i.grid.shape[0] for i in instances), max(i.grid.shape[1] for i in instances)
    grids = {id(instance.grid): on_canvas(instance.grid, shape) for instance in instances}
    return [_first(instance, count, grids[id(instance.grid)]) for instance in instances]


def load_pogema(instances: str | Path, num_agents: int | None = None) -> list[Instance]:
    """Return instances of POGEMA's benchmark or in its format, with their first `num_agents` agents.

    In lifelong instances, each agent has a sequence of goals; sequences may differ in length. The metric
    `exhausted_agents` counts the agents that reached the end of their sequence.

    Args:
        instances: The name of bundled instances: `pogema-random`, `pogema-mazes`, `pogema-warehouse`, `pogema-cities`,
            `pogema-puzzles`, or one of these with `-lifelong`; or the path of a file `SET.mapf.json` or
            `SET.lmapf.json`, whose maps are in `SET.maps.json` in the same folder.
        num_agents: Number of agents; None: as many as the smallest instance has.

    Raises:
        FileNotFoundError: A file does not exist.
        FormatError: A file is malformed, or an instance has too few agents or does not fit its map.
        ValueError: The name is unknown, or `num_agents` is less than 1, or more than bundled instances have.
    """
    if isinstance(instances, str) and not instances.endswith(PROBLEM_ENDING):
        _check_name("instances of POGEMA's benchmark", instances, pogema.instance_names())
        return pogema.read_instances(instances, num_agents)
    return read_pogema(instances, num_agents)


def load_problem(problem: str | Path) -> LorrProblem:
    """Return a problem of the League of Robot Runners.

    Args:
        problem: The name of a bundled example of 2023: `warehouse_small_10`, 50, 60, 100, 200, 400 or 800, or
            `random_20`, 50, 100, 200, 400, 600 or 800; or the path of a problem's JSON file, as in `read_problem`.

    Raises:
        FileNotFoundError: A file does not exist.
        FormatError: A file is malformed.
        ValueError: The name is unknown.
    """
    if isinstance(problem, str) and not problem.endswith(PROBLEM_ENDING):
        _check_name("problem", problem, lorr.problem_names())
        return lorr.read_problem(problem)
    return read_problem(problem)


def _check_name(what: str, name: str, known: Sequence[str]) -> None:
    """Raise `ValueError` for an unknown name."""
    if name not in known:
        raise ValueError(f"no {what} named {name!r}: {expected_names(name, known)}; a path ends in {PROBLEM_ENDING}")


def _is_problem(name: str | Path) -> bool:
    name = str(name)
    return name.endswith(PROBLEM_ENDING) or pogema.is_bundled(name) or name in lorr.problem_names()


def _named_map(scenarios: Sequence[str | Path | Scenario]) -> str | Path:
    """Return the map that scenarios name, as `scenario_map` does, or the default map if none of them is a file."""
    maps = {scenario_map(scenario): scenario for scenario in scenarios if not isinstance(scenario, Scenario)}
    if len(maps) > 1:
        first, second = list(maps.items())[:2]
        got = f"{str(first[0])!r} ({first[1]}) and {str(second[0])!r} ({second[1]})"
        raise ValueError(f"scenario: expected scenarios of one map, got those of {got}")
    return next(iter(maps), None) or DEFAULT_MAP


def _of_scenario(scenario: str | Path | Scenario, grid: Grid, num_agents: int | None) -> Instance:
    agents = load_scenario(scenario, grid)
    instance = Instance(grid, agents.first(_count(num_agents, len(agents), _name(scenario))))
    if isinstance(scenario, Scenario):
        check_reachable(instance)
    else:
        _check_file(instance, scenario)
    return instance


def _of_problem(path: str, num_agents: int | None, goals_per_agent: int) -> list[Instance]:
    """Return the instances of a problem, after checking them."""
    if path.endswith(POGEMA_ENDINGS) or pogema.is_bundled(path):
        instances = load_pogema(path, num_agents)
        for number, instance in enumerate(instances):
            _check_file(instance, f"{path}: instance {number}")
        return instances
    problem = load_problem(path)
    try:
        instance = problem.instance(goals_per_agent)
    except ValueError as error:
        raise FormatError(path, str(error)) from None
    return [_first(instance, _count(num_agents, instance.num_agents, path), instance.grid)]


def _check_file(instance: Instance, where: object) -> None:
    """Raise `FormatError` unless all agents of an instance from a file can reach their goals."""
    try:
        check_reachable(instance)
    except ValueError as error:
        raise FormatError(where, str(error)) from None


def _first(instance: Instance, count: int, grid: Grid) -> Instance:
    """Return the instance of the first `count` agents on the map `grid`, which contains the instance's map."""
    if count == instance.num_agents and grid is instance.grid:
        return instance
    headings = None if instance.headings is None else instance.headings[:count]
    return Instance(grid, instance.scenario.first(count), headings, instance.delays)


def _name(scenario: str | Path | Scenario) -> str:
    return "the scenario" if isinstance(scenario, Scenario) else str(scenario)


def _count(num_agents: int | None, available: int, origin: str) -> int:
    """Return the number of agents to use; raises `ValueError` if there are too few."""
    if num_agents is not None and num_agents > available:
        raise ValueError(f"num_agents={num_agents}: {origin} has {available} agents")
    return available if num_agents is None else num_agents


def sample_headings(headings: HeadingName | ArrayLike, count: int, rng: np.random.Generator) -> Ints:
    """Return the headings of `count` agents: `random`, all `east`, or (count,) numbers; raises `ValueError`."""
    if not isinstance(headings, str):
        return np.asarray(headings)
    if headings not in ("east", "random"):
        raise ValueError(f"headings={headings!r}: expected 'east', 'random' or {count} numbers 0 to 3")
    return np.full(count, Heading.EAST) if headings == "east" else rng.integers(4, size=count)
