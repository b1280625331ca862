"""Instances from files: a map, the first agents of a scenario, and how they face."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from mapf_pz.actions import Heading
from mapf_pz.arrays import Bools, Ints
from mapf_pz.config import ActionModel, HeadingName
from mapf_pz.instance import Grid, Instance, Scenario
from mapf_pz.instances.library import load_map, load_scenario
from mapf_pz.instances.place import check_reachable, place


def load_instance(
    map: str | Path | Bools | Grid,
    scenario: str | Path | Scenario | None = None,
    num_agents: int | None = None,
    action_model: ActionModel = "rotate",
    headings: HeadingName | ArrayLike = "east",
    seed: int = 0,
) -> Instance:
    """Return the instance of the first agents of a scenario on a map.

    Args:
        map: As `load_map` takes it.
        scenario: As `load_scenario` takes it; None draws starts and goals.
        num_agents: How many agents; None: all of the scenario's.
        action_model: `rotate`: agents have headings; `cardinal`: they have none.
        headings: At the start, for agents that turn: `east`, `random`, or (N,) numbers 0 to 3 (`Heading`).
        seed: Of what is drawn.

    Raises:
        FileNotFoundError: There is no such file.
        FormatError: A file is malformed, or the scenario does not fit the map.
        ValueError: The scenario has fewer agents, one cannot reach its goal, or a value is not allowed.
    """
    rng = np.random.default_rng(seed)
    grid = load_map(map)
    if num_agents is not None and num_agents < 1:
        raise ValueError(f"num_agents={num_agents}: expected a whole number, 1 or more")
    if scenario is not None:
        agents = _first(load_scenario(scenario, grid), num_agents, scenario)
    elif num_agents is not None:
        agents = place(grid, num_agents, rng)
    else:
        raise ValueError("num_agents: expected a number, as there is no scenario")
    instance = Instance(grid, agents, _headings(headings, len(agents), rng) if action_model == "rotate" else None)
    check_reachable(instance)
    return instance


def _first(agents: Scenario, num_agents: int | None, origin: object) -> Scenario:
    count = len(agents) if num_agents is None else num_agents
    if count > len(agents):
        name = "scenario" if isinstance(origin, Scenario) else str(origin)
        raise ValueError(f"{name}: expected {count} agents, got {len(agents)}")
    return agents.first(count)


def _headings(headings: HeadingName | ArrayLike, count: int, rng: np.random.Generator) -> Ints:
    if not isinstance(headings, str):
        return np.asarray(headings)
    if headings not in ("east", "random"):
        raise ValueError(f"headings={headings!r}: expected 'east', 'random' or {count} numbers 0 to 3")
    return np.full(count, Heading.EAST) if headings == "east" else rng.integers(4, size=count)
