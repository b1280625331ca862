"""The commands `mapf-pz solve` and `mapf-pz schedule`: solve an instance or run a problem, and write the plan."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar, NoReturn

import numpy as np
from tyro.conf import Positional

from mapf_pz._internal.parallel import use_one_thread
from mapf_pz.evaluation.solver import PolicySolver, costs_text, no_plan_text, solver_of
from mapf_pz.evaluation.tracker import known_cost
from mapf_pz.instances import load_problem
from mapf_pz.instances.instance import Instance, Scenario
from mapf_pz.instances.library import scenario_name
from mapf_pz.planners import Planner, planner_of, validate, write_trace
from mapf_pz.planners.base import guidance_of, lower_bound
from mapf_pz.planners.named import import_code
from mapf_pz.planners.plans.files import PlanMetadata, check_format, write_plan
from mapf_pz.planners.plans.plan import Plan
from mapf_pz.planners.scheduling import SCHEDULERS, run_problem
from mapf_pz.simulator.config import EnvConfig
from mapf_pz.simulator.keywords import EnvKeywords
from mapf_pz.simulator.source import sample_instance


class PlanningKeywords(EnvKeywords):
    """The fields of an environment that matter to a planner offline."""

    FIELDS: ClassVar[tuple[str, ...]] = (
        *("map", "scenario", "num_agents", "action_model", "initial_heading"),
        *("edge_weights", "max_steps", "distance_bytes"),
    )


SOLVER_KEYWORDS = ("max_steps", "edge_weights", "distance_bytes")
"""The fields that a solver takes beside the instance."""
MAX_NAMED = 100
"""Maximum number of agents that an error message names."""
SOLVED = PlanningKeywords({"action_model": "rotate", "max_steps": 1000, "initial_heading": "east"})
"""The default instance and limits."""


@dataclass(frozen=True)
class SolveOptions:
    """Options of `mapf-pz solve`: the output file, a planner or a policy, and an instance."""

    output: Positional[Path]
    """Output file: `.json` (League of Robot Runners), `.csv` (MAPF tracker, cardinal agents), `.txt` (PIBT, LaCAM)."""
    planner: str = "pibt"
    """Planner or policy, optionally with options, such as `epibt:depth=5`, `lacam:anytime=False` or
    `oneshot+pibt`; or your own, `package.module:Class`. The plan of a policy is the steps that it takes."""
    env: PlanningKeywords = SOLVED
    """The instance, and limits of the plan. The reported costs are in steps; with edge weights, the cost in weights is
    also printed. Without edge weights, a policy has those of its training, and planners have uniform ones."""
    time_limit: float = 10.0
    """Time limit in seconds."""
    partial: bool = False
    """Whether the steps of a policy or of a planner of single steps are also written if they end before all agents are
    at their goals. The exit status is 1 then, too."""
    seed: int = 0
    """Random seed."""
    trace: Path | None = None
    """Output file, `.csv`: the sum of costs of each better solution that an anytime planner (`lacam`, `prioritized`)
    found, and the seconds until then. None: not written."""


class GuidanceKeywords(EnvKeywords):
    """The guidance graph of an environment."""

    FIELDS: ClassVar[tuple[str, ...]] = ("edge_weights",)


UNIFORM = GuidanceKeywords.of(EnvConfig())
"""The default guidance graph."""


@dataclass(frozen=True)
class ScheduleOptions:
    """Options of `mapf-pz schedule`: a problem, a planner, and a scheduler."""

    problem: Positional[str]
    """Problem of the League of Robot Runners: the name of a bundled one, such as `warehouse_small_100`, or a `.json`
    file."""
    output: Positional[Path | None] = None
    """Output file of the plan, `.json` or `.txt`. Default: the plan is not written."""
    planner: str = "epibt"
    """Name of the planner, with options as in `epibt:depth=5,time_limit=0.1`."""
    scheduler: str = "shortest"
    """Name of the scheduler: `keep`, `nearest` or `shortest`."""
    env: GuidanceKeywords = UNIFORM
    """The guidance graph."""
    num_steps: int = 600
    """Number of steps."""
    seed: int = 0
    """Random seed."""


def solve(options: SolveOptions) -> None:
    """Solve an instance, validate and write the plan, and print its costs. The exit status is 1 if there is no plan."""
    use_one_thread()
    import_code(options.planner)
    solver = solver_of(options.planner, options.seed)
    env = options.env.config()
    check_format(options.output, env.action_model)
    instance = sample_instance(env, options.seed)
    limits = {name: value for name, value in options.env.keywords.items() if name in SOLVER_KEYWORDS}
    plan = solver.solve(instance, options.time_limit, partial=True, **limits)
    seconds = solver.trace.seconds
    metadata = PlanMetadata(_scenario_name(env), options.planner, seconds)
    if plan is None or plan.away(instance).any():
        _report_unsolved(solver, plan, instance, options, metadata)
    bound = plan.sum_of_costs if solver.optimal else lower_bound(instance, env.distance_bytes)
    _write(plan, instance, options.output, replace(metadata, lower_bound=bound))
    if options.trace is not None:
        options.trace.parent.mkdir(parents=True, exist_ok=True)
        write_trace(solver.trace, options.trace)
    print(f"{options.output}: {costs_text(plan, bound)}, {seconds:.3g} seconds")
    if env.edge_weights != "uniform":
        cost = plan.weighted_cost(guidance_of(instance, env.edge_weights, options.seed))
        print(f"weighted cost: {cost:.6g}")
    known = known_cost(metadata.scenario_name, plan.num_agents)
    if env.action_model == "cardinal" and known.best:
        ratio = plan.sum_of_costs / known.best
        print(f"MAPF tracker: {ratio:.3f} times the best known cost {known.best}, lower bound {known.lower}")


def _report_unsolved(
    solver: Planner | PolicySolver,
    plan: Plan | None,
    instance: Instance,
    options: SolveOptions,
    metadata: PlanMetadata,
) -> NoReturn:
    """Raise `RuntimeError` with the agents that are not at their goals; with `partial`, write the steps before."""
    limits = f"{options.time_limit:g} seconds and {options.env.config().max_steps} steps"
    if plan is None or (solver.unsolvable and not options.partial):
        raise RuntimeError(no_plan_text(options.planner, solver, instance, limits))
    away = np.flatnonzero(plan.away(instance)).tolist()
    written = "not written without --partial"
    if options.partial:
        _write(plan, instance, options.output, metadata)
        written = f"written to {options.output}"
    named = ", ".join(map(str, away[:MAX_NAMED])) + (", ..." if len(away) > MAX_NAMED else "")
    raise RuntimeError(
        f"{options.planner}: {len(away)} of {plan.num_agents} agents are not at their goals after {plan.num_steps} "
        f"steps: {named} (limits: {limits}; {written})"
    )


def schedule(options: ScheduleOptions) -> None:
    """Run a problem, validate and write the plan, and print the number of finished tasks."""
    if options.scheduler not in SCHEDULERS:
        raise ValueError(f"scheduler {options.scheduler!r}: expected one of {', '.join(SCHEDULERS)}")
    if options.output is not None:
        check_format(options.output, "rotate")
    problem = load_problem(options.problem)
    import_code(options.planner)
    planner, scheduler = planner_of(options.planner, options.seed), SCHEDULERS[options.scheduler]
    planner.compile("rotate")
    start = time.perf_counter()
    run = run_problem(problem, planner, scheduler, options.num_steps, options.seed, options.env.config().edge_weights)
    seconds = time.perf_counter() - start
    metadata = PlanMetadata(problem.name, options.planner, seconds, schedule=run.schedule)
    _write(run.plan, run.instance, options.output, metadata)
    print(
        f"{problem.name}: {problem.team_size} agents finished {run.num_finished} tasks in {options.num_steps} steps, "
        f"{1000 * seconds / options.num_steps:.1f} ms a step"
    )


def _write(plan: Plan, instance: Instance, output: Path | None, metadata: PlanMetadata) -> None:
    """Validate a plan, whose agents need not be at their goals, and write it if there is an output.

    Raises `RuntimeError` if it is illegal.
    """
    violation = validate(instance, plan)
    if violation is not None and violation.kind != "goal":
        raise RuntimeError(f"{metadata.solver} returned an illegal plan: {violation}")
    if output is not None:
        output.parent.mkdir(parents=True, exist_ok=True)
        write_plan(plan, output, instance, metadata)


def _scenario_name(env: EnvConfig) -> str:
    """Return the name of the scenario's file; empty if there is not exactly one."""
    map = None if env.map is None else Path(str(env.map)).stem
    names = [Path(scenario_name(name, map)).stem for name in env.scenarios if not isinstance(name, Scenario)]
    return names[0] if len(names) == 1 else ""
