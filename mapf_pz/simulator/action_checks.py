"""Checks of the actions that a PettingZoo environment is given: errors name the agent and what is expected."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from operator import index
from typing import SupportsIndex

import numpy as np

from mapf_pz._internal.arrays import Ints


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
    """Return the action as an int; raises `ValueError` unless it is in 0 to `num_actions` - 1."""
    try:
        number = index(action)
    except TypeError:
        number = -1
    if number not in range(num_actions):
        raise ValueError(f"action {action!r} of {agent!r}: expected a whole number from 0 to {num_actions - 1}")
    return number
