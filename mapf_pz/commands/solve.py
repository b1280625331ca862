"""The command `mapf-pz solve`: let a planner solve an instance, and write its plan."""

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
    """Which instance, who solves it, and where the plan goes."""

    output: Positional[Path]
    """The plan: `.json` (League of Robot Runners), `.csv` (MAPF tracker, cardinal agents) or `.txt` (PIBT, LaCAM)."""
    planner: str = "pibt"
    """The planner's name."""
    map: str = "empty-8-8"
    """A map's name or the path of a `.map` file."""
    scenario: str | None = None
    """The path of a `.scen` file for that map; None draws starts and goals."""
    num_agents: int | None = None
    """The first agents of the scenario; None: all."""
    action_model: ActionModel = "rotate"
    """Whether agents turn and drive or step in four directions. Those that turn face east at the start."""
    edge_weights: WeightsName = "uniform"
    """The guidance graph that the planner follows; costs are counted in steps all the same."""
    time_limit: float = 10.0
    """Seconds."""
    max_steps: int = 1000
    """The longest plan that is allowed."""
    distance_bytes: int | None = None
    """The most memory for cost-to-go tables, in bytes; None: as much as is needed, up to half of the machine's."""
    seed: int = 0
    """Of whatever is drawn."""


def solve(options: SolveOptions) -> None:
    """Solve an instance, check the plan, write it, and print what it costs; exit status 1 where there is no plan."""
    if options.planner not in PLANNERS:
        raise ValueError(f"planner {options.planner!r}: expected one of {', '.join(PLANNERS)}")
    check_format(options.output, options.action_model)
    instance = load_instance(options.map, options.scenario, options.num_agents, options.action_model, seed=options.seed)
    planner = PLANNERS[options.planner](seed=options.seed)
    planner.compile(options.action_model)
    began = time.perf_counter()
    plan = planner.solve(instance, options.time_limit, options.max_steps, options.edge_weights, options.distance_bytes)
    seconds = time.perf_counter() - began
    if plan is None:
        limits = f"{options.time_limit:g} seconds and {options.max_steps} steps"
        raise RuntimeError(f"{options.planner} found no plan for {instance.num_agents} agents within {limits}")
    violation = validate(instance, plan)
    if violation is not None:
        raise RuntimeError(f"{options.planner} made a plan that is not legal: {violation}")
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
    """Return the sum of the steps that agents with one goal each need where they are alone."""
    simulator = simulator_of(instance, max_steps=1, edge_weights="uniform", seed=0, distance_bytes=distance_bytes)
    return int(simulator.distance_to_go(0).sum())
