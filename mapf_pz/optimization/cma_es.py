"""`cma` and `cma-weights`: CMA-ES over the parameters of the feedback rule, or over all edge weights.

Hansen, *The CMA Evolution Strategy: A Tutorial*, 2016, by the package `cma`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mapf_pz._internal.arrays import Floats
from mapf_pz.guidance import GuidanceGraph, open_edges
from mapf_pz.optimization.candidate import Candidate
from mapf_pz.optimization.feedback import iterate
from mapf_pz.optimization.rule import LARGEST_LOG_WEIGHT, STEP_SIZES, FeedbackRule
from mapf_pz.optimization.search import Search

RULES = 8
"""Number of rules in each generation."""
WEIGHTS_DEVIATION = 0.3
"""Initial standard deviation of the logarithms of edge weights."""


def cma(search: Search, share: float = 1.0) -> None:
    """Optimize the rule's parameters until `share` of the budget is spent; a rule's score is that of its best graph."""
    strategy = strategy_for(search, FeedbackRule().vector(), 1.0, popsize=RULES, CMA_stds=STEP_SIZES)
    while not search.is_over(share):
        vectors = strategy.ask()
        scores = iterate(search, [FeedbackRule.from_vector(vector) for vector in vectors], share)
        strategy.tell(vectors, [-score for score in scores])


def cma_weights(search: Search, share: float = 1.0) -> None:
    """Optimize the logarithms of all weights, with a diagonal covariance matrix, from crisscross weights.

    This is the method of Zhang et al., IJCAI 2024, but for the covariance matrix, whose full form takes too long here.
    """
    free = search.task.grid.free
    edges = open_edges(free)
    start = GuidanceGraph.crisscross(free)
    mean = np.concatenate([np.log(start.move[edges]), np.log(start.wait[free])]).astype(np.float64)
    strategy = strategy_for(search, mean, WEIGHTS_DEVIATION, CMA_diagonal=True)
    while not search.is_over(share):
        vectors = strategy.ask()
        candidates = [Candidate(_graph(vector, edges)) for vector in vectors]
        results = search.evaluate(candidates)
        strategy.tell(vectors, [-result.score for result in results])


def _graph(log_weights: Floats, edges: np.ndarray) -> GuidanceGraph:
    """Return the graph with these logarithms of weights: of all edges (4, H, W) that are True, then of waiting."""
    weights = np.exp(np.clip(log_weights, -LARGEST_LOG_WEIGHT, LARGEST_LOG_WEIGHT))
    free = edges.any(axis=0)
    move, wait = np.full(edges.shape, np.inf), np.ones(free.shape)
    move[edges] = weights[: edges.sum()]
    wait[free] = weights[edges.sum() :][: free.sum()]
    return GuidanceGraph(move, wait)


def strategy_for(search: Search, mean: Floats, deviation: float, **options: Any) -> Any:
    """Return a `cma.CMAEvolutionStrategy` with a seed of the search; `options` are the package's."""
    import cma as package  # an optional dependency

    seed = int(search.rng.integers(1, 2**31))
    return package.CMAEvolutionStrategy(mean, deviation, {"seed": seed, "verbose": -9, **options})
