"""The command `mapf-pz execute`: execute a plan while agents are delayed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mapf_pz._internal.atomic import write_whole
from mapf_pz.commands.plans.planfile import LoadedPlan, PlanSource
from mapf_pz.instances.delays import Delays
from mapf_pz.planners.plans.delayed import DelayedExecution, execute_delayed
from mapf_pz.planners.plans.dependencies import DependencyGraph
from mapf_pz.planners.plans.files import PlanMetadata, check_format, write_plan
from mapf_pz.planners.plans.plan import Violation, validate
from mapf_pz.planners.plans.record import record_execution
from mapf_pz.render import Recording, save_html


@dataclass(frozen=True)
class ExecuteOptions(PlanSource):
    """Options of `mapf-pz execute`: a plan file, its map and scenario or its problem, and delays."""

    delays: str | None = None
    """Delays, `PROBABILITY:SMALLEST-LARGEST`, optionally with `:poisson` and `:normal`. None: those of the problem, or
    `0.01:1-4` if it has none."""
    seeds: tuple[int, ...] = (0,)
    """Random seeds of the delays, one for each execution."""
    switch: bool = False
    """Whether agents may go before others that are late, where that is predicted to be cheaper."""
    output: Path | None = None
    """Output file of the executed plan of the first seed: `.json`, `.csv` or `.txt`. None: not written."""
    graph: Path | None = None
    """Output file of the dependency graph, `.json`. None: not written."""
    page: Path | None = None
    """Output file of a page that plays the execution of the first seed, `.html`: it shows which agents are delayed, and
    who waits for whom. None: not written."""


def execute_plan(options: ExecuteOptions) -> None:
    """Execute a plan by its dependency graph while agents are delayed, validate the result, and print what was lost.

    For each seed, it prints the costs of the execution, and what they would be if no agent waited for others.
    """
    loaded = options.load()
    instance, plan = loaded.instance, loaded.file.plan
    if options.output is not None:
        check_format(options.output, "cardinal" if plan.headings is None else "rotate")
    if options.page is not None and options.page.suffix.lower() != ".html":
        raise ValueError(f"{options.page}: expected a file name that ends in .html")
    delays = instance.delays or Delays() if options.delays is None else Delays.from_text(options.delays)
    _check(validate(instance, plan), f"{options.plan}: not legal")
    graph = DependencyGraph.from_plan(plan)
    kind = "switchable dependencies" if options.switch else "dependencies"
    print(f"{options.plan}: {_costs(plan.costs)}, {plan.num_agents} agents, {len(graph.dependencies)} {kind}")
    if options.graph is not None:
        write_whole(options.graph, graph.to_json().encode())
    rows: list[tuple[float, ...]] = []
    for k, seed in enumerate(options.seeds):
        execution = execute_delayed(graph, delays, seed, options.switch)
        _check(validate(instance, execution.plan), f"seed {seed}: the execution is not legal")
        costs, alone = execution.plan.costs, execution.costs_alone
        rows.append((costs.sum(), costs.max(initial=0), alone.sum(), alone.max(initial=0)))
        print(f"seed {seed}: {_costs(costs)}; if no agent waited for others: {_costs(alone)}")
        if k == 0 and options.output is not None:
            metadata = PlanMetadata("", f"execution of {options.plan.name}", 0)
            write_plan(execution.plan, options.output, instance, metadata)
        if k == 0 and options.page is not None:
            facts = {"plan": options.plan.name, "delays": str(delays), "seed": str(seed)}
            save_html(_recording(loaded, execution, facts), options.page)
    if len(rows) > 1:
        total, makespan, total_alone, makespan_alone = np.mean(rows, axis=0)
        print(
            f"mean: sum of costs {total:.6g}, makespan {makespan:.6g}; if no agent waited for others: "
            f"sum of costs {total_alone:.6g}, makespan {makespan_alone:.6g}"
        )


def _recording(loaded: LoadedPlan, execution: DelayedExecution, facts: dict[str, str]) -> Recording:
    """Return the recording of an execution, with its costs if agents have one goal each."""
    recording = record_execution(loaded.instance, execution, loaded.has_goals)
    plan = execution.plan
    metrics = {} if recording.lifelong else {"SoC": plan.sum_of_costs, "makespan": plan.makespan}
    return replace(recording, name=f"execution of {facts['plan']}", facts=facts, metrics=metrics)


def _check(violation: Violation | None, text: str) -> None:
    """Raise `ValueError` for a violation, unless it is that agents are not at their goals."""
    if violation is not None and violation.kind != "goal":
        raise ValueError(f"{text}: {violation}")


def _costs(costs: np.ndarray) -> str:
    return f"sum of costs {costs.sum()}, makespan {costs.max(initial=0)}"
