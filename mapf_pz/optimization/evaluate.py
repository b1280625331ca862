"""Compare guidance graphs by the protocol of the literature: the same seeds for all, means and standard errors."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from mapf_pz._internal.parallel import job_runner
from mapf_pz.guidance import GuidanceGraph
from mapf_pz.optimization.simulation import simulate
from mapf_pz.optimization.task import GuidanceTask


@dataclass(frozen=True)
class Comparison:
    """Scores of a guidance graph."""

    name: str
    """Name of the graph."""
    scores: tuple[float, ...]
    """Score of each seed."""

    @property
    def mean(self) -> float:
        """The mean score."""
        return float(np.mean(self.scores))

    @property
    def standard_error(self) -> float:
        """The standard error of the mean; NaN for a single score."""
        return float(np.std(self.scores, ddof=1) / len(self.scores) ** 0.5) if len(self.scores) > 1 else float("nan")


def compare(
    task: GuidanceTask,
    graphs: Mapping[str, GuidanceGraph],
    num_seeds: int = 50,
    first_seed: int = 0,
    jobs: int | str = 1,
    on_episode: Callable[[], object] = lambda: None,
) -> list[Comparison]:
    """Run an episode of each graph with each seed.

    Args:
        task: The planner or policy, and its episodes: Zhang et al., IJCAI 2024, use 50 lifelong episodes of 1000 steps.
        graphs: Guidance graphs by name.
        num_seeds: Number of seeds.
        first_seed: The first seed; optimizations use no seed below one million.
        jobs: Number of processes, or `ray`.
        on_episode: Is called after each episode.

    Returns:
        The scores of each graph, in the order of `graphs`.
    """
    if num_seeds < 1:
        raise ValueError(f"num_seeds={num_seeds}: expected 1 or more")
    items = [
        _Job(name, seed, task, graph)
        for name, graph in graphs.items()
        for seed in range(first_seed, first_seed + num_seeds)
    ]
    found: dict[tuple[str, int], float] = {}
    with job_runner(jobs) as run:
        for name, seed, score in run(_score, items):
            found[name, seed] = score
            on_episode()
    return [
        Comparison(name, tuple(found[name, seed] for seed in range(first_seed, first_seed + num_seeds)))
        for name in graphs
    ]


@dataclass(frozen=True)
class _Job:
    name: str
    seed: int
    task: GuidanceTask
    graph: GuidanceGraph


def _score(job: _Job) -> tuple[str, int, float]:
    return job.name, job.seed, simulate(job.task, job.graph, job.seed).score
