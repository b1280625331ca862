"""Candidates of a search: guidance graphs with the scores that they had so far."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from mapf_pz.guidance import GuidanceGraph
from mapf_pz.optimization.rule import FeedbackRule, Traffic
from mapf_pz.optimization.simulation import Simulation
from mapf_pz.optimization.usage import Usage


@dataclass(frozen=True, eq=False)
class Origin:
    """The rule and the traffic that a guidance graph was made from, with which the rule can be applied again."""

    rule: FeedbackRule
    """The rule."""
    traffic: Traffic
    """Its traffic."""


@dataclass(eq=False)
class Candidate:
    """A guidance graph under evaluation."""

    graph: GuidanceGraph
    """The graph."""
    origin: Origin | None = None
    """Where it comes from; None: it was not made by a rule."""
    scores: list[float] = field(default_factory=list)
    """Scores of episodes with different seeds."""
    usage: Usage | None = None
    """Mean usage of these episodes; None: there was none yet."""

    @property
    def mean(self) -> float:
        """The mean score; minus infinity if there is none yet."""
        return float(np.mean(self.scores)) if self.scores else -np.inf

    def add(self, simulation: Simulation) -> None:
        """Add the score and the usage of an episode."""
        count, seen = len(self.scores), simulation.usage
        self.scores.append(simulation.score)
        if self.usage is None:
            self.usage = seen
        else:
            moves, waits = self.usage.moves * count + seen.moves, self.usage.waits * count + seen.waits
            self.usage = Usage(moves / (count + 1), waits / (count + 1))


def ranked(candidates: Iterable[Candidate]) -> list[Candidate]:
    """Return the candidates that have scores, the best first.

    They are compared by their mean score minus its standard error, since the best of many noisy scores is too high.
    The deviation of a single score is estimated from all candidates with several scores.
    """
    known = [candidate for candidate in candidates if candidate.scores]
    deviations = [np.std(candidate.scores, ddof=1) for candidate in known if len(candidate.scores) > 1]
    deviation = float(np.median(deviations)) if deviations else 0.0
    return sorted(known, key=lambda candidate: deviation / len(candidate.scores) ** 0.5 - candidate.mean)
