"""The command `mapf-pz schedule`: run a problem of the League of Robot Runners, and assign its tasks to the robots."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from tyro.conf import Positional

from mapf_pz.commands.env_flags import EnvKeywords
from mapf_pz.instances.files.lorr import load_problem
from mapf_pz.planners import planner_of, validate
from mapf_pz.planners.plans.files import PlanMetadata, check_format, write_plan
from mapf_pz.planners.scheduling import SCHEDULERS, run_problem
from mapf_pz.simulator.config import EnvConfig


class GuidanceKeywords(EnvKeywords):
    """The guidance graph of an environment."""

    FIELDS: ClassVar[tuple[str, ...]] = ("edge_weights",)


UNIFORM = GuidanceKeywords.of(EnvConfig())
"""The default guidance graph."""


@dataclass(frozen=True)
class ScheduleOptions:
    """Options of `mapf-pz schedule`: a problem, a planner, and a scheduler."""

    problem: Positional[Path]
    """Problem file of the League of Robot Runners, `.json`."""
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


def schedule(options: ScheduleOptions) -> None:
    """Run a problem, validate and write the plan, and print the number of finished tasks."""
    if options.scheduler not in SCHEDULERS:
        raise ValueError(f"scheduler {options.scheduler!r}: expected one of {', '.join(SCHEDULERS)}")
    if options.output is not None:
        check_format(options.output, "rotate")
    problem = load_problem(options.problem)
    planner, scheduler = planner_of(options.planner, options.seed), SCHEDULERS[options.scheduler]
    planner.compile("rotate")
    start = time.perf_counter()
    run = run_problem(problem, planner, scheduler, options.num_steps, options.seed, options.env.config().edge_weights)
    seconds = time.perf_counter() - start
    violation = validate(run.instance, run.plan)
    if violation is not None:
        raise RuntimeError(f"{options.planner} returned an illegal plan: {violation}")
    if options.output is not None:
        options.output.parent.mkdir(parents=True, exist_ok=True)
        metadata = PlanMetadata(problem.name, options.planner, seconds, schedule=run.schedule)
        write_plan(run.plan, options.output, run.instance, metadata)
    print(
        f"{problem.name}: {problem.team_size} agents finished {run.num_finished} tasks in {options.num_steps} steps, "
        f"{1000 * seconds / options.num_steps:.1f} ms a step"
    )
