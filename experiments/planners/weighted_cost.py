"""Measure what planners gain from knowing edge weights: `python -m experiments.planners.weighted_cost`.

Each planner plans the same instances once with the weights of a guidance graph and once with uniform weights. Both
plans are priced in the graph's weights. `docs/results/weighted-costs.csv` gets both costs of each instance, and
`docs/explanation/guidance-graphs.md` the table of their ratios.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import tyro

from experiments.pages import FILES, PAGES, key_of, write_table
from experiments.study import Study, StudyOptions
from mapf_pz.evaluation.reports.intervals import mean_interval
from mapf_pz.guidance import GuidanceGraph
from mapf_pz.instances import RandomObstacles
from mapf_pz.instances.instance import Instance
from mapf_pz.planners import Planner, planner_of
from mapf_pz.planners.base import guidance_of
from mapf_pz.planners.deadline import WorkClock

PAGE = PAGES / "guidance-graphs.md"

PLANNERS = {
    "pibt": "pibt",
    "epibt": "epibt",
    "windowed": "windowed",
    "prioritized": "prioritized:clock=work",
    "lacam": "lacam:clock=work",
    "cbs": "cbs",
}
"""The planners with options, by their names in the table."""
CASES = tuple(product(("cardinal", "rotate"), ("crisscross", "random")))
"""Action models and edge weights."""
SIZE, DENSITY, NUM_AGENTS = 16, 0.1, 16
KEY = ("planner", "action_model", "weights", "seed")
STUDY = Study(FILES / "weighted-costs.csv", KEY, ("known", "unknown"))
"""The weighted costs of the plans with and without knowledge of the weights; empty: there is no plan."""


@dataclass(frozen=True)
class Options(StudyOptions):
    """Options of the experiment."""

    seeds: int = 20
    """Number of instances, each of another map."""
    time_limit: float = 0.1
    """Time limit of a plan in seconds: of work for `prioritized` and `lacam`, otherwise of CPU time."""


def main(options: Options) -> None:
    """Plan the instances without results, write the costs after each, and the table at the end."""
    if not options.write:
        plans = ((name, *case, seed) for name in PLANNERS for case in CASES for seed in range(options.seeds))
        for name, model, weights, seed in STUDY.missing(plans):
            instance = instance_of(seed, model)
            graph = guidance_of(instance, weights, seed)
            costs = priced(made(PLANNERS[name], seed), instance, graph, options.time_limit)
            cells = ("" if cost is None else f"{cost:.4f}" for cost in costs)
            STUDY.add((name, model, weights, seed), dict(zip(STUDY.measures, cells, strict=True)))
    write()


def instance_of(seed: int, model: str) -> Instance:
    """Return the random instance of a seed and an action model; agents that turn have random headings."""
    rng = np.random.default_rng(seed)
    drawn = RandomObstacles(SIZE, SIZE, DENSITY, NUM_AGENTS).sample(rng)
    return Instance(drawn.grid, drawn.scenario, rng.integers(4, size=NUM_AGENTS) if model == "rotate" else None)


def made(name: str, seed: int) -> Planner:
    """Return a planner whose time limits do not depend on other processes."""
    planner = planner_of(name, seed)
    if not isinstance(planner.clock, WorkClock):
        planner.clock = time.thread_time
    return planner


def priced(
    planner: Planner, instance: Instance, graph: GuidanceGraph, time_limit: float
) -> tuple[float | None, float | None]:
    """Return the costs in a graph's weights of the plans with these weights and with uniform ones; None: no plan."""
    plans = (planner.solve(instance, time_limit, edge_weights=weights) for weights in (graph, "uniform"))
    known, unknown = (None if plan is None else plan.weighted_cost(graph) for plan in plans)
    return known, unknown


def write() -> None:
    """Write the table: means with 95 % intervals."""
    write_table(PAGE, "weighted costs", table(STUDY.rows()))


def table(rows: Sequence[Mapping[str, str]]) -> Iterator[str]:
    """Yield the lines of the table in Markdown."""
    names = {"cardinal": "four directions", "rotate": "turning"}
    yield f"| planner | {' | '.join(f'{names[model]}, `{weights}`' for model, weights in CASES)} |"
    yield f"| --- |{' --- |' * len(CASES)}"
    for name in dict.fromkeys(row["planner"] for row in rows):
        yield f"| `{name}` | {' | '.join(cell(rows, name, model, weights) for model, weights in CASES)} |"


def cell(rows: Sequence[Mapping[str, str]], planner: str, model: str, weights: str) -> str:
    """Return the mean ratio of the costs with its interval, and of how many instances it is, if not of all."""
    key = (planner, model, weights)
    chosen = [row for row in rows if key_of(row, KEY[:3]) == key]
    ratios = [float(row["known"]) / float(row["unknown"]) for row in chosen if row["known"] and row["unknown"]]
    if not ratios:
        return f"0 of {len(chosen)} instances"
    low, high = mean_interval(ratios)
    solved = "" if len(ratios) == len(chosen) else f", {len(ratios)} of {len(chosen)} instances"
    return f"{np.mean(ratios):.3f} ({low:.3f} to {high:.3f}){solved}"


if __name__ == "__main__":
    main(tyro.cli(Options))
