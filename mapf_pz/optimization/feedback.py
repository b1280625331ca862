"""`feedback`: the feedback rule with fixed parameters, repeated from several starts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from mapf_pz.optimization.candidate import Candidate, Origin
from mapf_pz.optimization.rule import FeedbackRule
from mapf_pz.optimization.search import Search

ITERATIONS = 10
"""Number of updates of each start."""
STARTS = (0.0, 0.3, -0.3, 1.0, -1.0)
"""Values of `FeedbackRule.crisscross` to start from."""


def feedback(search: Search, share: float = 1.0) -> None:
    """Repeat the default rule from one start after another until `share` of the time budget is spent."""
    attempt = 0
    while not search.is_over(share):
        rules = [
            replace(FeedbackRule(), crisscross=STARTS[(attempt + k) % len(STARTS)]) for k in range(search.num_jobs)
        ]
        attempt += len(rules)
        iterate(search, rules, share)


def iterate(search: Search, rules: Sequence[FeedbackRule], share: float) -> list[float]:
    """Apply each rule `ITERATIONS` times, side by side, and return the best score of each."""
    free = search.task.grid.free
    traffic = [rule.start(free) for rule in rules]
    best = [-float("inf")] * len(rules)
    for _ in range(ITERATIONS):
        candidates = [
            Candidate(rule.graph(state, free), Origin(rule, state)) for rule, state in zip(rules, traffic, strict=True)
        ]
        results = search.evaluate(candidates)
        best = [max(pair) for pair in zip(best, (result.score for result in results), strict=True)]
        if search.is_over(share):
            break
        traffic = [
            rule.update(state, result.usage, free) for rule, state, result in zip(rules, traffic, results, strict=True)
        ]
    return best
