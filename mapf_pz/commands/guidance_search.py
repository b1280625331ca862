"""The commands `mapf-pz guidance evaluate`, `mapf-pz guidance optimize` and `mapf-pz guidance resume`."""

from __future__ import annotations

import sys
from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table
from tyro.conf import Positional

from mapf_pz._internal.interrupts import interruptible
from mapf_pz.evaluation.episodes import changed_keywords
from mapf_pz.guidance.library import guidance_graph
from mapf_pz.optimization import search
from mapf_pz.optimization.config import OptimizeConfig
from mapf_pz.optimization.evaluate import Comparison, compare
from mapf_pz.optimization.folder import GRAPH_FILE, read_optimization
from mapf_pz.optimization.optimize import Optimized, optimize, resume
from mapf_pz.optimization.task import GuidanceTask


@dataclass(frozen=True, kw_only=True)
class EvaluateGuidance:
    """Compare guidance graphs on the same seeds: mean scores and their standard errors."""

    task: GuidanceTask = field(default_factory=GuidanceTask)
    """The planner or policy, and its episodes."""
    graphs: tuple[str, ...] = ("uniform", "crisscross")
    """Guidance graphs by name, or paths of their files."""
    num_seeds: int = 50
    """Number of episodes of each graph."""
    first_seed: int = 0
    """Seed of the first episode, which increases by one per episode."""
    jobs: int | str = 1
    """Number of processes; `ray`: run on a Ray cluster."""


@dataclass(frozen=True, kw_only=True)
class OptimizeGuidance:
    """Optimize a guidance graph for a planner or policy on a map."""

    config: OptimizeConfig = field(default_factory=OptimizeConfig)
    """The optimization."""
    output: Path = Path("runs/guidance")
    """Folder for the graph (`guidance.json`), the history (CSV), the candidates and pictures."""


@dataclass(frozen=True, kw_only=True)
class ResumeGuidance:
    """Continue an optimization with its configuration and candidates, for another time budget."""

    output: Positional[Path]
    """The folder of the optimization."""
    minutes: float | None = None
    """Time budget in minutes, the final selection included. None: as configured."""
    jobs: int | str | None = None
    """Number of processes; `ray`: run on a Ray cluster. None: as configured."""
    trust_remote_code: bool = False
    """Load a configuration and a policy that name code outside this package, and run that code."""


def evaluate_guidance(options: EvaluateGuidance) -> None:
    """Compare guidance graphs, and print a table."""
    task = options.task
    if "edge_weights" in changed_keywords(task.env):
        raise ValueError("edge_weights: expected --graphs, which are compared")
    graphs = {name: guidance_graph(name, task.grid) for name in options.graphs}
    with interruptible() as check, _bar("evaluating", len(graphs) * options.num_seeds) as advance:

        def on_episode() -> None:
            check()
            advance(1, "")

        found = compare(task, graphs, options.num_seeds, options.first_seed, options.jobs, on_episode)
    _print_table(task, found)


def _print_table(task: GuidanceTask, found: list[Comparison]) -> None:
    table = Table("guidance graph", "goals per step" if task.is_lifelong else "- cost per agent", "standard error")
    for row in found:
        table.add_row(row.name, f"{row.mean:.3f}", f"{row.standard_error:.3f}")
    Console(file=sys.stdout, width=None if sys.stdout.isatty() else 120).print(table)


def optimize_guidance(options: OptimizeGuidance) -> None:
    """Optimize a guidance graph, and write it with its history."""
    _show(options.config, options.output, partial(optimize, options.config, options.output))


def resume_guidance(options: ResumeGuidance) -> None:
    """Continue the optimization in a folder."""
    config = read_optimization(options.output, options.trust_remote_code)
    if options.minutes is not None:
        config = replace(config, minutes=options.minutes)
    run = partial(
        resume,
        options.output,
        options.minutes,
        options.jobs,
        trust_remote_code=options.trust_remote_code,
    )
    _show(config, options.output, run)


def _show(config: OptimizeConfig, output: Path, run: Callable[[Callable[[search.Progress], None]], Optimized]) -> None:
    """Run an optimization with a progress bar, and print its result."""
    with interruptible() as check, _bar("optimizing", round(60 * config.minutes)) as advance:

        def on_progress(progress: search.Progress) -> None:
            check()
            advance(progress.seconds, f"best {progress.best:.3f} in {progress.simulations} simulations")

        result = run(on_progress)
    ending = "interrupted; the best graph so far" if result.interrupted else "the best graph"
    unit = "goals per step" if config.task.is_lifelong else "score"
    print(f"{ending}: {result.score:.3f} {unit} in {result.num_scores} episodes, written to {output / GRAPH_FILE}")


@contextmanager
def _bar(title: str, total: int) -> Generator[Callable[[float, str], None]]:
    """Show a progress bar; yield the function that sets or advances it and describes the state."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[state]}"),
    )
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(title, total=total, state="")

        def show(amount: float, state: str) -> None:
            if state:
                bar.update(task, completed=round(amount), state=state)
            else:
                bar.advance(task, amount)

        yield show
