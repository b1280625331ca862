"""The command `mapf-pz validate`: whether a plan file is legal, what it costs, and whether it tells the truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from tyro.conf import Positional

from mapf_pz.commands.planfile import load_plan
from mapf_pz.instance import Instance
from mapf_pz.plans.plan import Plan, validate


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
    file, instance, finished, _ = load_plan(
        options.plan, options.map, options.scenario, options.num_agents, options.problem
    )
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
