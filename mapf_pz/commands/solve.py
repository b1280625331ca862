"""The command `mapf-pz solve`: solve an instance with a planner, and write the plan."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

from tyro.conf import Positional

from mapf_pz.config import ActionModel, WeightsName
from mapf_pz.instance import Instance
from mapf_pz.instances import load_instance
from mapf_pz.planners import PLANNERS, validate
from mapf_pz.planners.base import simulator_of
from mapf_pz.plans.files import About, check_format, write_plan


@dataclass(frozen=True)
class SolveOptions:
    """Options of `mapf-pz solve`: the output file, a planner, and an instance."""

    output: Positional[Path]
    """Output file: `.json` (League of Robot Runners), `.csv` (MAPF tracker, cardinal agents), `.txt` (PIBT, LaCAM)."""
    planner: str = "pibt"
    """Name of the planner."""
    map: str = "empty-8-8"
    """Name of a map, or path of a `.map` file."""
    scenario: str | None = None
    """Path of a `.scen` file for the map. None: starts and goals are random."""
    num_agents: int | None = None
    """Number of agents, the first ones of the scenario. None: all agents."""
    action_model: ActionModel = "rotate"
    """`rotate`: agents turn and move forward, and face east at the start; `cardinal`: agents move in four
    directions."""
    edge_weights: WeightsName = "uniform"
    """Guidance graph of the planner. The reported costs are in steps regardless."""
    time_limit: float = 10.0
    """Time limit in seconds."""
    max_steps: int = 1000
    """Maximum number of steps of the plan."""
    distance_bytes: int | None = None
    """Maximum memory for cost-to-go tables in bytes. None: as needed, up to half of the machine's memory."""
    seed: int = 0
    """Random seed."""


def solve(options: SolveOptions) -> None:
    """Solve an instance, validate and write the plan, and print its costs. The exit status is 1 if there is no plan."""
    if options.planner not in PLANNERS:
        raise ValueError(f"planner {options.planner!r}: expected one of {', '.join(PLANNERS)}")
    check_format(options.output, options.action_model)
    instance = load_instance(options.map, options.scenario, options.num_agents, options.action_model, seed=options.seed)
    planner = PLANNERS[options.planner](seed=options.seed)
    planner.compile(options.action_model)
    start = time.perf_counter()
    plan = planner.solve(instance, options.time_limit, options.max_steps, options.edge_weights, options.distance_bytes)
    seconds = time.perf_counter() - start
    if plan is None:
        limits = f"{options.time_limit:g} seconds and {options.max_steps} steps"
        raise RuntimeError(f"{options.planner} found no plan for {instance.num_agents} agents within {limits}")
    violation = validate(instance, plan)
    if violation is not None:
        raise RuntimeError(f"{options.planner} returned an illegal plan: {violation}")
    options.output.parent.mkdir(parents=True, exist_ok=True)
    scenario = "" if options.scenario is None else Path(options.scenario).stem
    write_plan(plan, options.output, instance, About(scenario, options.planner, seconds))
    bound = lower_bound(instance, options.distance_bytes)
    ratio = plan.sum_of_costs / bound if bound else 1.0
    print(
        f"{options.output}: {plan.num_agents} agents, sum of costs {plan.sum_of_costs}, makespan {plan.makespan}, "
        f"{ratio:.3f} times the lower bound {bound}, {seconds:.3g} seconds"
    )


def lower_bound(instance: Instance, distance_bytes: int | None = None) -> int:
    """Return the sum of the shortest path lengths of agents with one goal each."""
    simulator = simulator_of(instance, max_steps=1, edge_weights="uniform", seed=0, distance_bytes=distance_bytes)
    return int(simulator.cost_to_go(0).sum())
