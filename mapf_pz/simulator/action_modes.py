"""Decoders of continuous actions: each agent has A values in [-1, 1], one per discrete action.

A decoder takes the values (N, A) and a random generator, and returns the discrete actions (N,) int64.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np

from mapf_pz._internal.arrays import Floats, Ints

ActionMode = Literal["argmax", "affine", "sigmoid", "softmax"]
Decoder = Callable[[Floats, np.random.Generator], Ints]


def argmax(values: Floats, rng: np.random.Generator) -> Ints:
    """Return the action with the largest value; of equal values, the first. Deterministic."""
    return values.argmax(axis=1)


def affine(values: Floats, rng: np.random.Generator) -> Ints:
    """Sample with weights `(a + 1) / 2`, as in the report's published code; if all are 0, sample uniformly.

    An action with the value -1 is sampled only if all values are -1.
    """
    weights = (values + 1) / 2
    weights[weights.sum(axis=1) == 0] = 1
    return _sample(weights, rng)


def sigmoid(values: Floats, rng: np.random.Generator) -> Ints:
    """Sample with weights `(sigmoid(a) + 1) / 2`, the formula in the report.

    The distribution is always nearly uniform: with 4 actions, probabilities are between 19.6 % and 31.3 %.
    """
    return _sample((1 / (1 + np.exp(-values)) + 1) / 2, rng)


def softmax(values: Floats, rng: np.random.Generator) -> Ints:
    """Sample with weights `exp(a)`; with 4 actions, probabilities are at most 71.1 %."""
    return _sample(np.exp(values), rng)


ACTION_MODES: dict[ActionMode, Decoder] = {"argmax": argmax, "affine": affine, "sigmoid": sigmoid, "softmax": softmax}
"""The decoders by name."""


def _sample(weights: Floats, rng: np.random.Generator) -> Ints:
    """Sample a column for each row of `weights` (N, A), with probabilities proportional to the weights."""
    bounds = weights.cumsum(axis=1)
    # In (0, total], since 0 would select a first action of weight 0.
    points = (1 - rng.random((len(weights), 1))) * bounds[:, -1:]
    return (points > bounds).sum(axis=1)
