"""Evolution: a population of graphs, which improve by the feedback rule while its parameters evolve."""

from __future__ import annotations

import numpy as np

from mapf_pz.optimization.candidate import Candidate, Origin, ranked
from mapf_pz.optimization.rule import STEP_SIZES, FeedbackRule
from mapf_pz.optimization.search import Search

POPULATION = 16
CHILDREN = 8
"""Number of new graphs in each generation."""
REPEATED = 4
"""Number of the best graphs that are simulated again in each generation, so that lucky scores do not last."""
MOST_SCORES = 12
PARENT_SCALE = 4.0
"""Mean rank of parents."""
CROSSOVER = 0.3
"""Probability that a parameter comes from a second parent."""
START_SCALE, MUTATION = 0.7, 0.3
"""Standard deviations of the first parameters and of changes, in `STEP_SIZES`."""


def evolution(search: Search) -> None:
    """Improve a population until the search is over.

    A child applies the rule once more to its parent's traffic and usage, with the parameters of one or two parents and
    random changes: population-based training (Jaderberg et al., 2017) with the feedback rule in place of gradients.
    """
    population = [candidate for candidate in search.archive if candidate.origin is not None]
    if len(population) < POPULATION:
        population += _first(search, POPULATION - len(population))
    generation = 0
    while not search.is_over():
        generation += 1
        population = ranked(population)[:POPULATION]
        children = [_child(search, population) for _ in range(CHILDREN)]
        search.evaluate(children)
        population += children
        limit = min(1 + generation // 2, MOST_SCORES)
        again = [candidate for candidate in ranked(population)[:CHILDREN] if len(candidate.scores) < limit]
        if again:
            search.evaluate(again[:REPEATED])


def _first(search: Search, count: int) -> list[Candidate]:
    """Return the graphs of `count` random rules before any traffic, evaluated."""
    free, center = search.task.grid.free, FeedbackRule().vector()
    candidates = []
    for _ in range(count):
        noise = search.rng.normal(size=center.size) * STEP_SIZES * START_SCALE
        rule = FeedbackRule.from_vector(center + noise)
        traffic = rule.start(free)
        candidates.append(Candidate(rule.graph(traffic, free), Origin(rule, traffic)))
    search.evaluate(candidates)
    return candidates


def _child(search: Search, population: list[Candidate]) -> Candidate:
    """Apply the rule of one or two parents, with changed parameters, to the first parent's traffic and usage."""
    free, rng = search.task.grid.free, search.rng
    parent, other = (population[min(int(rng.exponential(PARENT_SCALE)), len(population) - 1)] for _ in range(2))
    assert parent.origin is not None
    assert parent.usage is not None
    assert other.origin is not None
    own, others = parent.origin.rule.vector(), other.origin.rule.vector()
    mixed = np.where(rng.random(own.size) < CROSSOVER, others, own)
    rule = FeedbackRule.from_vector(mixed + rng.normal(size=own.size) * STEP_SIZES * MUTATION)
    traffic = rule.update(parent.origin.traffic, parent.usage, free)
    return Candidate(rule.graph(traffic, free), Origin(rule, traffic))
