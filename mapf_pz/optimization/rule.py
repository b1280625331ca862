"""A rule that turns the usage of edges in one episode into the edge weights of the next."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from mapf_pz._internal.arrays import Bools, Floats
from mapf_pz.guidance import GuidanceGraph, open_edges
from mapf_pz.guidance.edges import opposite_edges
from mapf_pz.optimization.usage import Usage

LARGEST_LOG_WEIGHT = 6.0
"""Bound of the logarithms of weights, so that costs along paths stay exact enough in float32."""


class Traffic(NamedTuple):
    """What a rule has learned about a map so far."""

    direction: Floats  # (4, H, W): how much more an edge is used than the opposite one, -1 to 1
    waiting: Floats  # (H, W): how often agents wait on a cell, relative to the mean over free cells
    flow: Floats  # (H, W): how often agents leave a cell, relative to the mean over free cells, minus 1


@dataclass(frozen=True, kw_only=True)
class FeedbackRule:
    """Repeated simulation, in which edges become cheaper in the direction in which they are used more.

    After an episode with `U` moves over an edge and `U'` over the opposite one, the running means move by `rate`
    toward `(U - U') / (U + U' + prior)`, and likewise for waiting and flow. The logarithm of an edge's weight is
    `-direction_gain / 2 * direction + waiting_gain * waiting + flow_gain * flow`, the latter two of the cell that it
    leaves. The two directions of a passage separate by themselves, and agents avoid crowded cells.
    """

    direction_gain: float = 1.3
    """Logarithm of the largest ratio between the weights of the two directions."""
    rate: float = 0.5
    """Step size of the running means, 0 to 1."""
    prior: float = 6.0
    """Number of moves that an edge's usage is compared with: the larger, the less rarely used edges count."""
    waiting_gain: float = 0.15
    """Logarithm of the factor by which a cell with the mean waiting time is more expensive to leave."""
    flow_gain: float = 0.15
    """The same for a cell that is left twice as often as the mean."""
    wait_weight: float = 0.9
    """Cost of waiting."""
    crisscross: float = 0.3
    """Direction of the start: positive as in `GuidanceGraph.crisscross`, negative reversed, 0 none."""

    def start(self, free: Bools) -> Traffic:
        """Return the traffic before the first episode, on the map `free` (H, W)."""
        along = GuidanceGraph.crisscross(np.ones_like(free), along=1, against=2).move == 1
        nothing = np.zeros(free.shape)
        return Traffic(self.crisscross * np.where(along, 1.0, -1.0), nothing, nothing)

    def update(self, traffic: Traffic, usage: Usage, free: Bools) -> Traffic:
        """Return the traffic after an episode with this usage."""
        back, leaving = opposite_edges(usage.moves), usage.moves.sum(axis=0)
        seen = Traffic(
            (usage.moves - back) / (usage.moves + back + self.prior),
            usage.waits / max(usage.waits[free].mean(), 1e-9),
            leaving / max(leaving[free].mean(), 1e-9) - 1,
        )
        return Traffic(*((1 - self.rate) * old + self.rate * new for old, new in zip(traffic, seen, strict=True)))

    def graph(self, traffic: Traffic, free: Bools) -> GuidanceGraph:
        """Return the guidance graph of the traffic."""
        crowding = self.waiting_gain * traffic.waiting + self.flow_gain * traffic.flow
        log_weight = crowding - self.direction_gain / 2 * traffic.direction
        weight = np.exp(log_weight.clip(-LARGEST_LOG_WEIGHT, LARGEST_LOG_WEIGHT))
        return GuidanceGraph(np.where(open_edges(free), weight, np.inf), np.full(free.shape, self.wait_weight))

    def vector(self) -> Floats:
        """Return the parameters as an unbounded vector (7,), in which positive ones are logarithms."""
        values = np.array([getattr(self, name) for name in _NAMES])
        values[_POSITIVE] = np.log(values[_POSITIVE])
        values[_RATE] = np.log(self.rate / (1 - self.rate))
        return values

    @classmethod
    def from_vector(cls, vector: Floats) -> FeedbackRule:
        """Return the rule with the parameters of `vector`."""
        values = np.array(vector, np.float64)
        values[_POSITIVE] = np.exp(values[_POSITIVE])
        values[_RATE] = 1 / (1 + np.exp(-vector[_RATE]))
        return cls(**dict(zip(_NAMES, values.tolist(), strict=True)))


_NAMES = [field.name for field in fields(FeedbackRule)]
_POSITIVE = [_NAMES.index(name) for name in ("direction_gain", "prior", "wait_weight")]
_RATE = _NAMES.index("rate")
STEP_SIZES = np.array([0.5, 0.7, 0.7, 0.1, 0.1, 0.3, 0.5])
"""(7,) how far each entry of the vector is varied at first."""
