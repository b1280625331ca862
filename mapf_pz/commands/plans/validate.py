"""The command `mapf-pz validate`: validate a plan file, compute its costs, and check its claims."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from mapf_pz.commands.plans.planfile import PlanSource
from mapf_pz.guidance import GuidanceGraph
from mapf_pz.guidance.library import guidance_graph, random_share
from mapf_pz.instances.instance import Instance
from mapf_pz.planners.plans.plan import Plan, validate, violations


@dataclass(frozen=True)
class ValidateOptions(PlanSource):
    """Options of `mapf-pz validate`: a plan file, and its map and scenario or its problem."""

    edge_weights: str | None = None
    """Guidance graph, by name or file, in whose weights the cost of a plan with one goal for each agent is also
    printed. `random` differs between episodes, and cannot be given."""
    all: bool = False
    """Print all violations, not only the first one."""


def validate_plan(options: ValidateOptions) -> None:
    """Validate a plan, and print its costs. If it is illegal, print the first violation, with exit status 1.

    With `--all`, print a line for each violation, then their number.

    With `--edge-weights`, the cost in the weights of a guidance graph is also printed.

    Costs and finished tasks are counted in a replay of the plan, and compared with the values in the file. In lifelong
    plans, every step of every agent counts as cost, as in the League of Robot Runners.
    """
    file, instance, finished, _ = options.load()
    graph = _graph(options.edge_weights, instance)
    if options.all and (found := violations(instance, file.plan)):
        print("\n".join(map(str, found)))
        raise ValueError(f"{options.plan}: not legal: {len(found)} violations")
    violation = validate(instance, file.plan)
    if violation is not None:
        raise ValueError(f"{options.plan}: not legal: {violation}")
    print(f"{options.plan}: legal, {file.plan.num_agents} agents, {file.plan.num_steps} steps")
    print_findings(_findings(file.plan, instance, finished), file.claims)
    if graph is not None:
        print(f"weighted cost: {file.plan.weighted_cost(graph):.6g}")


def _graph(edge_weights: str | None, instance: Instance) -> GuidanceGraph | None:
    """Return the guidance graph, if one is given; raise `ValueError` unless plans of the instance have a cost in it."""
    if edge_weights is None:
        return None
    if random_share(edge_weights):
        raise ValueError(f"--edge-weights {edge_weights}: expected weights that do not differ between episodes")
    if instance.scenario.goals.ndim == 3:
        raise ValueError("--edge-weights: expected a plan with one goal for each agent")
    return guidance_graph(edge_weights, instance.grid)


def print_findings(found: Mapping[str, int | None], claims: Mapping[str, int]) -> None:
    """Print the counted values (None: unknown), and whether they agree with the file."""
    for name, value in found.items():
        claim = claims.get(name)
        if value is None:
            suffix = "" if claim is None else f"; the file says {claim}"
            print(f"{name}: unknown, as the file does not contain the assigned tasks{suffix}")
        elif claim is None:
            print(f"{name}: {value}")
        else:
            print(f"{name}: {value}, {'as the file says' if claim == value else f'but the file says {claim}'}")


def _findings(plan: Plan, instance: Instance, finished: int | None) -> dict[str, int | None]:
    """Return the costs and the number of finished tasks of a legal plan; with one goal each, all agents finish one."""
    if instance.scenario.goals.ndim == 2:
        return {"sum of costs": plan.sum_of_costs, "makespan": plan.makespan, "tasks finished": plan.num_agents}
    cost = plan.num_steps * plan.num_agents
    return {"sum of costs": cost, "makespan": plan.num_steps, "tasks finished": finished}
