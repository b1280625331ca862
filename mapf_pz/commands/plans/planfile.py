"""Load plan files with their instances: a map and a scenario, or a problem of the League of Robot Runners."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import cycle
from pathlib import Path
from typing import NamedTuple

import numpy as np
from tyro.conf import Positional

from mapf_pz._internal.arrays import Ints
from mapf_pz.instances import load_instance, load_map
from mapf_pz.instances.files.lorr import ROUND_ROBIN, LorrProblem
from mapf_pz.instances.heading import Heading
from mapf_pz.instances.instance import Grid, Instance, Scenario
from mapf_pz.instances.library import scenario_map, scenario_name
from mapf_pz.instances.load import load_problem
from mapf_pz.planners.plans.files import PlanFile, Selection, read_plan
from mapf_pz.planners.plans.plan import reached


class LoadedPlan(NamedTuple):
    """A plan file and its instance."""

    file: PlanFile
    instance: Instance
    finished: int | None
    """Number of finished tasks if agents have several goals and the number is known."""
    has_goals: bool
    """Whether the instance contains the goals; otherwise they are in the schedule."""


@dataclass(frozen=True)
class PlanSource:
    """A plan file, and its map and scenario or its problem."""

    plan: Positional[Path]
    """Plan file: League of Robot Runners JSON, MAPF tracker CSV, or text of the PIBT and LaCAM tools."""
    map: str | None = None
    """Name of a map, or path of a `.map` file. None: the map that the scenario names."""
    scenario: str | None = None
    """Name or `.scen` file of a scenario. None: starts, goals and tasks are those of the plan file."""
    num_agents: int | None = None
    """Number of agents, the first ones of the scenario. None: that of the plan."""
    problem: str | None = None
    """League of Robot Runners problem, by name or `.json` file, instead of a map."""

    def load(self) -> LoadedPlan:
        """Read the files; raises as `load_plan` does."""
        return load_plan(self.plan, self.map, self.scenario, self.num_agents, self.problem)


def load_plan(
    plan: Path,
    map: str | None = None,
    scenario: str | None = None,
    num_agents: int | None = None,
    problem: str | Path | None = None,
) -> LoadedPlan:
    """Read a plan file: League of Robot Runners JSON, MAPF tracker CSV, or text of the PIBT and LaCAM tools.

    Args:
        plan: the file.
        map: the name of a map, or the path of a `.map` file. None: the map that the scenario names.
        scenario: the name or the `.scen` file of a scenario of the map. None: starts, goals and tasks are those of the
            plan file.
        num_agents: number of agents, the first ones of the scenario. None: that of the plan.
        problem: the name or the JSON file of a League of Robot Runners problem, instead of a map.

    Raises:
        ValueError: the arguments are incompatible.
        FileNotFoundError, FormatError: a file is missing or malformed.
    """
    if problem is None and map is None and scenario is not None:
        map = str(scenario_map(scenario)) or None
    if (map is None) == (problem is None) or (problem is not None and scenario is not None):
        raise ValueError("expected either --map or --scenario, or --problem")
    if scenario is None and num_agents is not None:
        raise ValueError("--num-agents: expected --scenario, too")
    if problem is not None:
        loaded = load_problem(problem)
        return _of_problem(read_plan(plan), loaded)
    return _of_map(plan, str(map), scenario, num_agents)


def _of_problem(file: PlanFile, problem: LorrProblem) -> LoadedPlan:
    finished = None if file.schedule is None else file.schedule.finished(file.plan, problem.task)
    if problem.strategy == ROUND_ROBIN:
        instance = problem.instance()
        paths = file.plan.positions.swapaxes(0, 1)
        arrivals = [reached(path, cycle(goals)) for path, goals in zip(paths, instance.scenario.goals, strict=False)]
        in_turn = sum(map(len, arrivals))
        # More tasks than that are finished if a scheduler has assigned them in another order.
        if finished is None or finished <= in_turn:
            return LoadedPlan(file, instance, in_turn, True)
    headings = np.full(problem.team_size, Heading.EAST)
    instance = replace(_without_goals(problem.grid, problem.starts, headings), delays=problem.delays)
    return LoadedPlan(file, instance, finished, False)


def _of_map(path: Path, name: str, scenario: str | None, num_agents: int | None) -> LoadedPlan:
    grid = load_map(name)
    if scenario is None:
        file = read_plan(path)
        plan = file.plan
        headings = None if plan.headings is None else plan.headings[0]
        if file.goals is not None:
            return LoadedPlan(file, Instance(grid, Scenario(plan.positions[0], file.goals), headings), None, True)
        finished = None if file.schedule is None else file.schedule.finished(plan)
        return LoadedPlan(file, _without_goals(grid, plan.positions[0], headings), finished, False)
    all_agents = load_instance(grid, scenario)
    file = read_plan(path, Selection(all_agents.scenario, num_agents, Path(scenario_name(scenario, grid.name)).stem))
    count = num_agents or file.plan.num_agents
    action_model = "cardinal" if file.plan.headings is None else "rotate"
    return LoadedPlan(file, load_instance(grid, scenario, count, action_model), None, True)


def _without_goals(grid: Grid, starts: Ints, headings: Ints | None) -> Instance:
    """Return a lifelong instance for a plan with goals in its schedule; the instance's goals are placeholders."""
    return Instance(grid, Scenario(starts, starts[:, None]), headings)
