"""The command `mapf-pz validate`: whether a plan file is legal, what it costs, and whether it tells the truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path

import numpy as np
from tyro.conf import Positional

from mapf_pz.instances import load_instance, load_map, read_map
from mapf_pz.instances.lorr import LORR_PASSABLE, ROUND_ROBIN, LorrProblem, load_problem
from mapf_pz.planners.files import PlanFile, Selection, read_plan
from mapf_pz.planners.plan import Plan, reached, validate
from mapf_pz.types import Grid, Heading, Instance, Ints, Scenario


@dataclass(frozen=True)
class ValidateOptions:
    """A plan file, and what it is for: a map and a scenario, or a problem of the League of Robot Runners."""

    plan: Positional[Path]
    """League of Robot Runners JSON, MAPF tracker CSV, or text of the PIBT and LaCAM tools."""
    map: str | None = None
    """A map's name or the path of a `.map` file."""
    scenario: str | None = None
    """The path of a `.scen` file for that map; None: starts, goals and tasks are as the plan file tells."""
    num_agents: int | None = None
    """The first agents of the scenario; None: as many as the plan has."""
    problem: Path | None = None
    """The JSON file of a League of Robot Runners problem, in place of a map."""


def validate_plan(options: ValidateOptions) -> None:
    """Tell whether a plan is legal: its costs, or in one line, with exit status 1, the first violation.

    Costs and finished tasks are counted by replaying the plan, and compared with what the file says. Where agents get
    one task after the other, every step of every agent counts as cost, as in the League of Robot Runners.
    """
    if (options.map is None) == (options.problem is None):
        raise ValueError("expected either --map or --problem")
    if options.map is None and options.scenario is not None:
        raise ValueError("--scenario: expected --map, too")
    if options.scenario is None and options.num_agents is not None:
        raise ValueError("--num-agents: expected --scenario, too")
    if options.problem is not None:
        problem = load_problem(options.problem)
        file = read_plan(options.plan)
        instance, finished = _of_problem(file, problem)
    else:
        file, instance, finished = _of_map(options, str(options.map))
    violation = validate(instance, file.plan)
    if violation is not None:
        raise ValueError(f"{options.plan}: not legal: {violation}")
    print(f"{options.plan}: legal, {file.plan.num_agents} agents, {file.plan.num_steps} steps")
    print_findings(_findings(file.plan, instance, finished), file.claims)


def print_findings(found: Mapping[str, int | None], claims: Mapping[str, int]) -> None:
    """Print what was counted (None: could not be), and whether the file says the same."""
    for name, value in found.items():
        claim = claims.get(name)
        if value is None:
            said = "" if claim is None else f"; the file says {claim}"
            print(f"{name}: unknown, as the file does not tell who was given which task{said}")
        elif claim is None:
            print(f"{name}: {value}")
        else:
            print(f"{name}: {value}, {'as the file says' if claim == value else f'but the file says {claim}'}")


def _findings(plan: Plan, instance: Instance, finished: int | None) -> dict[str, int | None]:
    """Return the costs and the number of tasks finished: one for each agent, if it has one goal (the plan is legal)."""
    if instance.scenario.goals.ndim == 2:
        return {"sum of costs": plan.sum_of_costs, "makespan": plan.makespan, "tasks finished": plan.num_agents}
    cost = plan.num_steps * plan.num_agents
    return {"sum of costs": cost, "makespan": plan.num_steps, "tasks finished": finished}


def _of_problem(file: PlanFile, problem: LorrProblem) -> tuple[Instance, int | None]:
    """Return the problem's instance, and how many of its tasks the plan finishes."""
    if problem.strategy == ROUND_ROBIN:
        instance = problem.instance()
        paths = file.plan.cells.swapaxes(0, 1)
        arrivals = [reached(path, cycle(goals)) for path, goals in zip(paths, instance.scenario.goals, strict=False)]
        return instance, sum(map(len, arrivals))
    headings = np.full(problem.team_size, Heading.EAST)
    instance = _without_goals(problem.grid, problem.starts, headings)
    return instance, None if file.schedule is None else file.schedule.finished(file.plan, problem.task)


def _of_map(options: ValidateOptions, name: str) -> tuple[PlanFile, Instance, int | None]:
    """Return the plan, its instance on a map, and how many tasks it finishes where goals come one after the other."""
    grid = read_map(name, LORR_PASSABLE) if name.endswith(".map") else load_map(name)
    if options.scenario is None:
        file = read_plan(options.plan)
        plan = file.plan
        headings = None if plan.headings is None else plan.headings[0]
        if file.goals is not None:
            return file, Instance(grid, Scenario(plan.cells[0], file.goals), headings), None
        finished = None if file.schedule is None else file.schedule.finished(plan)
        return file, _without_goals(grid, plan.cells[0], headings), finished
    everyone = load_instance(grid, options.scenario)
    file = read_plan(options.plan, Selection(everyone.scenario, options.num_agents, Path(options.scenario).stem))
    count = options.num_agents or file.plan.num_agents
    action_model = "cardinal" if file.plan.headings is None else "rotate"
    return file, load_instance(grid, options.scenario, count, action_model), None


def _without_goals(grid: Grid, starts: Ints, headings: Ints | None) -> Instance:
    """Return a lifelong instance for a plan in which a schedule tells the goals: those here are asked of nobody."""
    return Instance(grid, Scenario(starts, starts[:, None]), headings)
