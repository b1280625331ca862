"""Optimize a guidance graph within a time budget, with all files in one folder."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from mapf_pz._internal.lock import locked
from mapf_pz._internal.parallel import job_runner
from mapf_pz.guidance import GuidanceGraph
from mapf_pz.guidance.library import guidance_graph, random_share
from mapf_pz.optimization.candidate import Candidate
from mapf_pz.optimization.config import OptimizeConfig
from mapf_pz.optimization.evolution import evolution
from mapf_pz.optimization.folder import OptimizationFolder, read_optimization
from mapf_pz.optimization.search import Progress, Search
from mapf_pz.optimization.simulation import simulate
from mapf_pz.optimization.task import GuidanceTask


@dataclass(frozen=True)
class Optimized:
    """The result of an optimization."""

    graph: GuidanceGraph
    """The best graph."""
    score: float
    """Its mean score in the final selection, a little too high as it is the best of several; its mean score in the
    search if the optimization was interrupted."""
    num_scores: int
    """Number of episodes of this mean."""
    interrupted: bool
    """Whether Ctrl-C ended the optimization early."""


def optimize(
    config: OptimizeConfig,
    output: Path | None = None,
    on_progress: Callable[[Progress], object] = lambda progress: None,
) -> Optimized:
    """Optimize a guidance graph.

    Ctrl-C ends the optimization early and keeps the best graph.

    Args:
        config: The optimization.
        output: Folder for the graph, the candidates and the history. None: no files.
        on_progress: Is called after each round of simulations.

    Returns:
        The best graph. Uniform and crisscross weights and those of the task compete, too.

    Raises:
        BlockingIOError: Another process is writing to the folder.
        FileExistsError: The folder holds an optimization.
    """
    with locked(output):
        return _optimize(config, None if output is None else OptimizationFolder.create(output, config), on_progress)


def resume(
    folder: Path,
    minutes: float | None = None,
    jobs: int | str | None = None,
    on_progress: Callable[[Progress], object] = lambda progress: None,
    trust_remote_code: bool = False,
) -> Optimized:
    """Continue the optimization in a folder with its configuration and candidates, for another time budget.

    Args:
        folder: The folder of the optimization.
        minutes: Time budget in minutes. None: as configured.
        jobs: Number of processes, or `ray`. None: as configured.
        on_progress: Is called after each round of simulations.
        trust_remote_code: Whether the configuration and the policy may name code outside this package.

    Returns:
        The best graph, as from `optimize`.

    Raises:
        BlockingIOError: Another process is writing to the folder.
        FileNotFoundError: The folder holds no optimization.
        FormatError: One of its files is malformed, or names such code without `trust_remote_code`; or a file that it
            reads has changed: a map, a scenario or a policy.
    """
    changes = {name: value for name, value in (("minutes", minutes), ("jobs", jobs)) if value is not None}
    with locked(folder):
        config = replace(read_optimization(folder, trust_remote_code), **changes)
        return _optimize(config, OptimizationFolder.open(folder, config), on_progress)


def _optimize(
    config: OptimizeConfig, folder: OptimizationFolder | None, on_progress: Callable[[Progress], object]
) -> Optimized:
    """Optimize from the candidates in a folder, if there are any."""
    simulate(config.task, GuidanceGraph.crisscross(config.task.grid.free), seed=0, num_steps=1)  # compiles all kernels
    with job_runner(config.jobs) as run:
        search = Search(
            config.task,
            run,
            seconds=60 * config.minutes,
            rng=np.random.default_rng([config.seed, 0 if folder is None else folder.num_rows]),
            archive=[] if folder is None else folder.load_candidates(),
        )
        search.on_progress = partial(_report, search, folder, on_progress)
        try:
            evolution(search)
            best, interrupted = search.select(baselines(config.task)), False
        except KeyboardInterrupt:
            if not search.archive:
                raise
            best, interrupted = search.archive[0], True
    result = Optimized(best.graph, best.mean, len(best.scores), interrupted)
    if folder is not None:
        folder.save_result(search.archive, result.graph)
    return result


def baselines(task: GuidanceTask) -> list[Candidate]:
    """Return uniform and crisscross weights and those of the task, which the result should not be worse than."""
    names = dict.fromkeys(("uniform", "crisscross", task.config.edge_weights))
    return [Candidate(guidance_graph(weights, task.grid)) for weights in names if not random_share(weights)]


def _report(
    search: Search, folder: OptimizationFolder | None, on_progress: Callable[[Progress], object], progress: Progress
) -> None:
    if folder is not None:
        folder.add(progress, search.archive)
    on_progress(progress)
