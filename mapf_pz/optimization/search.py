"""A search for guidance graphs: simulations in parallel, a time budget, and the best candidates so far."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from mapf_pz._internal.parallel import RunJobs
from mapf_pz.guidance import GuidanceGraph
from mapf_pz.optimization.candidate import Candidate, ranked
from mapf_pz.optimization.simulation import Simulation, simulate
from mapf_pz.optimization.task import GuidanceTask
from mapf_pz.planners.deadline import Clock

ARCHIVE_SIZE = 24
"""Number of candidates that are kept."""
SELECTION = 0.12
"""Share of the time budget that is spent to choose among the best candidates."""
FIRST_SEED = 10**6
"""Seeds of the search are drawn from here on; smaller ones are left for tests of the result."""


@dataclass(frozen=True)
class Progress:
    """The state of a search, after some simulations."""

    seconds: float
    """Seconds since the start."""
    simulations: int
    """Number of simulations so far."""
    best: float
    """Mean score of the best candidate."""
    best_count: int
    """Number of its scores."""
    latest: float
    """Mean score of the latest simulations."""


@dataclass(eq=False)
class Search:
    """A search for the best guidance graph of a task.

    A method calls `evaluate` until `is_over`; all that it evaluates competes for the archive.
    """

    task: GuidanceTask
    """The task."""
    run: RunJobs
    """Runs simulations in parallel."""
    seconds: float
    """Time budget in seconds."""
    rng: np.random.Generator
    """Draws everything random, the seeds of simulations included."""
    archive: list[Candidate] = field(default_factory=list)
    """The best candidates, the best first."""
    on_progress: Callable[[Progress], object] = lambda progress: None
    """Is called after each round of simulations."""
    simulations: int = 0
    """Number of simulations so far."""

    clock: ClassVar[Clock] = staticmethod(time.monotonic)
    """The clock of the time budget."""

    def __post_init__(self) -> None:
        """Start the time."""
        self._started = self.clock()

    @property
    def elapsed(self) -> float:
        """Seconds since the start."""
        return self.clock() - self._started

    def is_over(self) -> bool:
        """Return whether the time budget is spent, except for the share of the selection."""
        return self.elapsed >= (1 - SELECTION) * self.seconds

    def draw_seed(self) -> int:
        """Return a new seed for simulations."""
        return int(self.rng.integers(FIRST_SEED, 2**31))

    def simulate(self, graphs: Sequence[GuidanceGraph], seeds: Sequence[int]) -> list[Simulation]:
        """Run an episode for each graph and its seed, and return the results in this order."""
        jobs = [
            _Job(index, self.task, graph, seed) for index, (graph, seed) in enumerate(zip(graphs, seeds, strict=True))
        ]
        results = dict(self.run(_run, jobs))
        self.simulations += len(jobs)
        return [results[index] for index in range(len(jobs))]

    def evaluate(self, candidates: Sequence[Candidate]) -> list[Simulation]:
        """Run an episode of each candidate with the same new seed, and let all compete for the archive."""
        seeds = [self.draw_seed()] * len(candidates)
        results = self.simulate([candidate.graph for candidate in candidates], seeds)
        for candidate, result in zip(candidates, results, strict=True):
            candidate.add(result)
        known = {id(candidate): candidate for candidate in (*self.archive, *candidates)}
        self.archive = ranked(known.values())[:ARCHIVE_SIZE]
        best = self.archive[0]
        latest = float(np.mean([result.score for result in results]))
        self.on_progress(Progress(self.elapsed, self.simulations, best.mean, len(best.scores), latest))
        return results

    def select(self, extra: Sequence[Candidate] = (), most: int = 8) -> Candidate:
        """Return the best candidate by fresh simulations: of the best in the archive, and of `extra`.

        All have the same seeds. After each round, the worse third drops out, until the time budget is spent or two
        candidates have 16 scores each.
        """
        fresh = [Candidate(candidate.graph, candidate.origin) for candidate in (*self.archive[:most], *extra)]
        while True:
            seeds = [self.draw_seed() for _ in range(2)]
            for candidate, result in zip(
                [candidate for candidate in fresh for _ in seeds],
                self.simulate([candidate.graph for candidate in fresh for _ in seeds], seeds * len(fresh)),
                strict=True,
            ):
                candidate.add(result)
            fresh.sort(key=lambda candidate: -candidate.mean)
            if self.elapsed >= self.seconds or (len(fresh) <= 2 and len(fresh[0].scores) >= 16):
                return fresh[0]
            fresh = fresh[: max(2, 2 * len(fresh) // 3)]


@dataclass(frozen=True)
class _Job:
    """A simulation that another process runs."""

    index: int
    task: GuidanceTask
    graph: GuidanceGraph
    seed: int


def _run(job: _Job) -> tuple[int, Simulation]:
    return job.index, simulate(job.task, job.graph, job.seed)
