"""The actions of agents, checks of those that an environment is given, and decoders of continuous actions.

A decoder takes A values in [-1, 1] for each agent, one per discrete action, (N, A), and a random generator; it returns
the discrete actions (N,) int64.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from enum import IntEnum
from operator import index
from typing import Literal, SupportsIndex

import numpy as np

from mapf_pz._internal.arrays import Floats, Ints


class Action(IntEnum):
    """The actions of `action_model="rotate"`, in the report's order."""

    FORWARD = 0
    ROTATE_LEFT = 1
    ROTATE_RIGHT = 2
    WAIT = 3


class CardinalAction(IntEnum):
    """The actions of `action_model="cardinal"`, in POGEMA's order."""

    WAIT = 0
    UP = 1
    DOWN = 2
    LEFT = 3
    RIGHT = 4


def wait_action(action_model: str) -> int:
    """Return the number of the wait action: `action_model` is `rotate` or `cardinal`."""
    return int(CardinalAction.WAIT if action_model == "cardinal" else Action.WAIT)


def check_dictionary(actions: object) -> None:
    """Raise `TypeError` unless the actions are a dictionary by agent."""
    if not isinstance(actions, Mapping):
        raise TypeError(f"actions: expected a dictionary with an action for each agent, got {type(actions).__name__}")


def check_agents(actions: Mapping[str, object], active: Iterable[str], possible: Sequence[str]) -> None:
    """Raise `ValueError` for unknown agents and missing actions; agents that have disappeared may have actions."""
    for agent in actions:
        if agent not in possible:
            raise ValueError(f"action for an unknown agent {agent!r}: expected names from possible_agents")
    for agent in active:
        if agent not in actions:
            raise ValueError(f"no action for {agent!r}: expected one for each active agent")


def whole_numbers(agents: Sequence[str], actions: Sequence[SupportsIndex], num_actions: int) -> Ints:
    """Return the actions (N,) uint8 of `agents` (N,); raises `ValueError` unless all are in 0 to `num_actions` - 1."""
    try:
        numbers = bytes(actions)  # faster than NumPy
    except (TypeError, ValueError):  # not all are whole numbers 0 to 255
        numbers = None
    if numbers is None or max(numbers) >= num_actions:
        numbers = bytes(_whole_number(*pair, num_actions) for pair in zip(agents, actions, strict=True))
    return np.frombuffer(numbers, np.uint8)


def _whole_number(agent: str, action: SupportsIndex, num_actions: int) -> int:
    """Return the action as an int; raises `ValueError` unless it is in 0 to `num_actions` - 1.

    NumPy's bool is a number like Python's, which Gymnasium's `Discrete` contains.
    """
    try:
        number = int(action) if isinstance(action, np.bool_) else index(action)
    except TypeError:
        number = -1
    if number not in range(num_actions):
        raise ValueError(f"action {action!r} of {agent!r}: expected a whole number from 0 to {num_actions - 1}")
    return number


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
