"""`piu`: a small model that updates edge weights from their usage, trained by CMA-ES.

Parameterized iterative update, Zhang et al., IJCAI 2024, there with a convolutional network of 4231 parameters. The
model here has `NUM_PARAMETERS` and is applied to each edge in coordinates relative to it, so that it treats all
directions alike. It adds a network to a linear rule, whose coefficients start at those of `FeedbackRule`. It transfers
to other maps and numbers of agents.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mapf_pz._internal.arrays import Bools, Floats
from mapf_pz._internal.npz import read_npz, write_npz
from mapf_pz.errors import FormatError
from mapf_pz.guidance import GuidanceGraph, open_edges
from mapf_pz.guidance.edges import opposite_edges
from mapf_pz.instances.heading import HEADING_STEPS
from mapf_pz.optimization.candidate import Candidate
from mapf_pz.optimization.rule import LARGEST_LOG_WEIGHT, FeedbackRule
from mapf_pz.optimization.search import Search
from mapf_pz.optimization.usage import Usage

NUM_FEATURES, HIDDEN = 10, 12
NUM_PARAMETERS = 2 + NUM_FEATURES + HIDDEN * (NUM_FEATURES + 2)
ITERATIONS = 6
"""Number of updates of an episode's graph."""
MODELS = 10
"""Number of models in each generation."""
NETWORK_DEVIATION = 0.1
"""Initial standard deviation of the network's parameters."""


@dataclass(frozen=True, eq=False)
class UpdateModel:
    """Updates of the logarithms of edge weights: `(1 - rate) * old + rate * (linear(x) + network(x))`."""

    parameters: Floats
    """(`NUM_PARAMETERS`,) logit of the rate, logarithm of the waiting cost, linear coefficients, network."""

    def __post_init__(self) -> None:
        """Check the number of parameters."""
        if self.parameters.shape != (NUM_PARAMETERS,):
            raise ValueError(f"update model: expected {NUM_PARAMETERS} parameters, got {self.parameters.shape}")

    @classmethod
    def initial(cls) -> UpdateModel:
        """Return the model that equals the default feedback rule, apart from its running means."""
        rule, parameters = FeedbackRule(), np.zeros(NUM_PARAMETERS)
        parameters[:2] = np.log(rule.rate / (1 - rule.rate)), np.log(rule.wait_weight)
        parameters[2], parameters[4], parameters[6] = -rule.direction_gain / 2, rule.waiting_gain, rule.flow_gain
        return cls(parameters)

    @classmethod
    def load(cls, path: str | Path) -> UpdateModel:
        """Read a model; raises `FormatError` unless the file is one that `save` has written."""
        parameters = read_npz(path, ("parameters",))["parameters"]
        if parameters.shape != (NUM_PARAMETERS,) or parameters.dtype.kind != "f" or not np.isfinite(parameters).all():
            expected = f"expected {NUM_PARAMETERS} finite parameters of an update model"
            raise FormatError(path, f"{expected}, got {parameters.dtype} {parameters.shape}")
        return cls(parameters.astype(np.float64))

    def save(self, path: str | Path) -> None:
        """Write the model to an `.npz` file, atomically."""
        write_npz(path, {"parameters": self.parameters})

    def update(self, log_weight: Floats, usage: Usage, free: Bools) -> Floats:
        """Return the logarithms of weights (4, H, W) after an episode with this usage."""
        features = _features(log_weight, usage, free)
        linear, rest = np.split(self.parameters[2:], [NUM_FEATURES])
        inner, outer = rest[: HIDDEN * (NUM_FEATURES + 1)].reshape(HIDDEN, NUM_FEATURES + 1), rest[-HIDDEN:]
        hidden = np.tanh(np.tensordot(inner[:, :-1], features, axes=1) + inner[:, -1, None, None, None])
        target = np.tensordot(linear, features, axes=1) + np.tensordot(outer, hidden, axes=1)
        rate = 1 / (1 + np.exp(-self.parameters[0]))
        return ((1 - rate) * log_weight + rate * target).clip(-LARGEST_LOG_WEIGHT, LARGEST_LOG_WEIGHT)

    def graph(self, log_weight: Floats, free: Bools) -> GuidanceGraph:
        """Return the graph with these logarithms of weights (4, H, W)."""
        wait = np.exp(np.clip(self.parameters[1], -LARGEST_LOG_WEIGHT, LARGEST_LOG_WEIGHT))
        return GuidanceGraph(np.where(open_edges(free), np.exp(log_weight), np.inf), np.full(free.shape, wait))


def _features(log_weight: Floats, usage: Usage, free: Bools) -> Floats:
    """Return the features (F, 4, H, W) of each directed edge from a cell `u` to a cell `v`."""
    moves, back = usage.moves, opposite_edges(usage.moves)
    direction = (moves - back) / (moves + back + FeedbackRule().prior)
    waits, flow = (
        np.broadcast_to(values / max(values[free].mean(), 1e-9), moves.shape)
        for values in (usage.waits, moves.sum(axis=0))
    )
    sides = [_neighbors(direction, 1) + _neighbors(direction, 3), _neighbors(direction, 0) + _neighbors(direction, 2)]
    edges = [
        direction,
        moves / max(moves[open_edges(free)].mean(), 1e-9) - 1,
        waits,
        _neighbors(waits, 0),
        flow - 1,
        _neighbors(flow, 0) - 1,
        log_weight,
        opposite_edges(log_weight),
        *sides,
    ]
    return np.stack(edges)


def _neighbors(values: Floats, turn: int) -> Floats:
    """Return for each directed edge the value (4, H, W) of the edge beside it: ahead, right, behind, left by `turn`."""
    shifted = np.zeros(values.shape)
    for heading in range(4):
        rows, cols = (int(step) for step in HEADING_STEPS[(heading + turn) % 4])
        source = values[heading, max(rows, 0) :, max(cols, 0) :]
        source = source[: source.shape[0] + min(rows, 0), : source.shape[1] + min(cols, 0)]
        top, left = max(-rows, 0), max(-cols, 0)
        shifted[heading, top : top + source.shape[0], left : left + source.shape[1]] = source
    return shifted


def piu(search: Search, model: UpdateModel | None = None) -> UpdateModel:
    """Train a model until the search is over, from `model` if given; return the best one.

    The score of a model is the best score of the graphs that it makes in sequence, from uniform weights on.
    """
    from cma import CMAEvolutionStrategy  # an optional dependency

    start = UpdateModel.initial() if model is None else model
    options = {
        "seed": int(search.rng.integers(1, 2**31)),
        "verbose": -9,
        "popsize": MODELS,
        "CMA_stds": np.full(NUM_PARAMETERS, NETWORK_DEVIATION),
        "CMA_diagonal": True,
    }
    strategy: Any = CMAEvolutionStrategy(start.parameters, 1.0, options)
    best, best_score = start, -np.inf
    vectors = [start.parameters]
    while True:
        models = [UpdateModel(np.asarray(vector)) for vector in vectors]
        scores = _iterate(search, models)
        top = int(np.argmax(scores))
        if scores[top] > best_score:
            best, best_score = models[top], scores[top]
        if search.is_over():
            return best
        if len(vectors) == MODELS:
            strategy.tell(vectors, [-score for score in scores])
        vectors = strategy.ask()


def _iterate(search: Search, models: list[UpdateModel]) -> list[float]:
    """Apply each model `ITERATIONS` times, side by side, and return the best score of each."""
    free = search.task.grid.free
    log_weights = [np.zeros((4, *free.shape)) for _ in models]
    best = [-np.inf] * len(models)
    for _ in range(ITERATIONS + 1):
        candidates = [
            Candidate(model.graph(log_weight, free)) for model, log_weight in zip(models, log_weights, strict=True)
        ]
        results = search.evaluate(candidates)
        best = [max(pair) for pair in zip(best, (result.score for result in results), strict=True)]
        if search.is_over():
            break
        log_weights = [
            model.update(log_weight, result.usage, free)
            for model, log_weight, result in zip(models, log_weights, results, strict=True)
        ]
    return best
