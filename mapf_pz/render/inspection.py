"""The decisions of a policy in a recording."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapf_pz._internal.arrays import Bools, Floats, Ints


@dataclass(frozen=True, eq=False)
class Inspection:
    """What the first M agents decided in T steps; entry t is the decision after step t, which step t + 1 executes.

    Agents that have disappeared have zeros, and -1 instead of actions and agents.

    Raises `ValueError` if the shapes differ from those below.
    """

    allowed: Bools
    """(T, M, A): the action masks of the environment."""
    features: Floats | None = None
    """(T, M, F): the features that the agents observed, from -1 to 1. None: there are none."""
    feature_names: tuple[str, ...] = ()
    """Names of the F features."""
    probabilities: Floats | None = None
    """(T, M, A): the policy's probabilities of actions. None: it has none, or they have no closed form."""
    means: Floats | None = None
    """(T, M, A): the means of a distribution of preferences, of a policy without probabilities."""
    preferred: Ints | None = None
    """(T, M): the action with the highest sampled preference. None: unknown."""
    ignored: Bools | None = None
    """(T, M): whether the safety layer ignored the agent's preferences. None: there is no safety layer."""
    attended: Ints | None = None
    """(T, M, L): the L agents with the largest weights in the agent's attention, in descending order. The agent itself
    may be one of them; -1: no other. None: agents do not communicate."""
    attention: Floats | None = None
    """(T, M, L): their weights, from 0 to 1; those of all agents sum to 1."""

    def __post_init__(self) -> None:
        """Check the shapes."""
        each, actions = self.allowed.shape[:2], self.allowed.shape
        shapes = {"probabilities": actions, "means": actions, "preferred": each, "ignored": each}
        shapes["features"] = (*each, len(self.feature_names))
        if self.attended is not None:
            shapes["attention"] = (*each, self.attended.shape[-1])
        for name, shape in shapes.items():
            value = getattr(self, name)
            if value is not None and value.shape != shape:
                raise ValueError(f"inspection: expected {name} of shape {shape}, got {value.shape}")

    @property
    def num_steps(self) -> int:
        """Number of steps T."""
        return self.allowed.shape[0]

    def sizes(self) -> dict[str, Any]:
        """Return the sizes and names that the page reads, as JSON."""
        return {
            "agents": self.allowed.shape[1],
            "actions": self.allowed.shape[2],
            "features": list(self.feature_names),
            "attended": 0 if self.attended is None else self.attended.shape[-1],
            "hasSafetyLayer": self.ignored is not None,
        }

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the arrays that the page reads, with the steps of each agent in consecutive order.

        Numbers are rounded: features to 16 bits, probabilities too, weights of attention to 8 bits.
        """
        bits = self.allowed @ (1 << np.arange(self.allowed.shape[2]))
        packed: dict[str, NDArray[Any] | None] = {
            "allowed": bits.astype(np.uint8),
            "features": _scaled(self.features, 2**15 - 1, "<i2"),
            "probabilities": _scaled(self.probabilities, 2**16 - 1, "<u2"),
            "means": None if self.means is None else self.means.astype("<f4"),
            "preferred": None if self.preferred is None else self.preferred.astype(np.int8),
            "ignored": None if self.ignored is None else self.ignored.astype(np.uint8),
            "attended": None if self.attended is None else self.attended.astype("<i2"),
            "attention": _scaled(self.attention, 2**8 - 1, "u1"),
        }
        return {name: array.swapaxes(0, 1) for name, array in packed.items() if array is not None}


def _scaled(values: Floats | None, unit: int, kind: str) -> NDArray[Any] | None:
    """Return values from -1 to 1 as whole numbers, in units of 1 / `unit`."""
    return None if values is None else np.rint(unit * values).astype(kind)
