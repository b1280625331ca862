"""How real numbers become actions: each agent gives A values in [-1, 1], one per action.

Every decoder takes the values (N, A) and a generator, and returns the actions (N,) int64.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np

from mapf_pz.arrays import Floats, Ints

ActionMode = Literal["argmax", "affine", "sigmoid", "softmax"]
Decoder = Callable[[Floats, np.random.Generator], Ints]


def argmax(values: Floats, rng: np.random.Generator) -> Ints:
    """Take the action of the largest value, the first of equal ones; nothing is drawn."""
    return values.argmax(axis=1)


def affine(values: Floats, rng: np.random.Generator) -> Ints:
    """Draw with weights `(a + 1) / 2`: the report's published code; where all are 0, each action is as likely.

    An action of value -1 is never drawn beside a larger one, and the only one above -1 always.
    """
    weights = (values + 1) / 2
    weights[weights.sum(axis=1) == 0] = 1
    return _draw(weights, rng)


def sigmoid(values: Floats, rng: np.random.Generator) -> Ints:
    """Draw with weights `(sigmoid(a) + 1) / 2`: the report's printed formula.

    It stays nearly uniform whatever the values: of 4 actions none is more likely than 31.3 % or less than 19.6 %.
    """
    return _draw((1 / (1 + np.exp(-values)) + 1) / 2, rng)


def softmax(values: Floats, rng: np.random.Generator) -> Ints:
    """Draw with weights `exp(a)`; of 4 actions none is more likely than 71.1 %."""
    return _draw(np.exp(values), rng)


ACTION_MODES: dict[ActionMode, Decoder] = {"argmax": argmax, "affine": affine, "sigmoid": sigmoid, "softmax": softmax}
"""The decoders by name."""


def _draw(weights: Floats, rng: np.random.Generator) -> Ints:
    """Draw one column per row of `weights` (N, A), in proportion to them; none of weight 0."""
    bounds = weights.cumsum(axis=1)
    # In (0, total]: 0 would fall on a first action of weight 0.
    points = (1 - rng.random((len(weights), 1))) * bounds[:, -1:]
    return (points > bounds).sum(axis=1)
