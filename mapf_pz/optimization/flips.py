"""`flips`: local search that turns around the preferred direction of lane segments."""

from __future__ import annotations

import numpy as np

from mapf_pz._internal.arrays import Floats
from mapf_pz.guidance import GuidanceGraph
from mapf_pz.instances.heading import HEADING_STEPS
from mapf_pz.optimization.candidate import Candidate
from mapf_pz.optimization.rule import FeedbackRule
from mapf_pz.optimization.search import Search

LONGEST = 12
"""Maximum length of a segment in cells."""
TRIALS = 8
"""Number of changed graphs that are compared with the best one at a time."""
ROUNDS = 2
"""Number of seeds in a comparison."""


def flips(search: Search, share: float = 1.0) -> None:
    """Exchange the weights of both directions of segments of the best graph until `share` of the budget is spent.

    A change is kept if it is better than the present graph on the same new seeds.
    """
    if not search.archive:
        start = FeedbackRule().graph(FeedbackRule().start(search.task.grid.free), search.task.grid.free)
        search.evaluate([Candidate(start)])
    best = search.archive[0]
    while not search.is_over(share):
        trials = [Candidate(_flipped(best.graph, search.rng)) for _ in range(TRIALS)]
        present = Candidate(best.graph, best.origin)
        for _ in range(ROUNDS):
            search.evaluate([present, *trials])
        winner = max(trials, key=lambda candidate: candidate.mean)
        if winner.mean > present.mean:
            best = winner


def _flipped(graph: GuidanceGraph, rng: np.random.Generator) -> GuidanceGraph:
    """Exchange the weights of both directions along a random straight segment."""
    move = graph.move.copy()
    direction = int(rng.integers(2))  # east or south; the opposite directions are the same segments
    starts = np.argwhere(np.isfinite(move[direction]))
    row, col = starts[rng.integers(len(starts))].tolist()
    step = HEADING_STEPS[direction].tolist()
    for _ in range(int(rng.integers(1, LONGEST + 1))):
        if not np.isfinite(move[direction, row, col]):
            break
        row, col = _exchange(move, direction, row, col, step)
    return GuidanceGraph(move, graph.wait)


def _exchange(move: Floats, direction: int, row: int, col: int, step: list[int]) -> tuple[int, int]:
    """Exchange the weights of an edge and the opposite one, and return the cell that it leads to."""
    ahead = row + step[0], col + step[1]
    back = (direction + 2, *ahead)
    if np.isfinite(move[back]):
        move[direction, row, col], move[back] = move[back], move[direction, row, col]
    return ahead
