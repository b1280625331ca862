"""`GuidanceGraph`: the edge weights of a map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mapf_pz.actions import HEADING_STEPS, Heading
from mapf_pz.arrays import Bools, EqualByValue, Floats, frozen


@dataclass(frozen=True, eq=False)
class GuidanceGraph(EqualByValue):
    """Edge weights of a map. Weights are planning costs, not durations: every action takes one step.

    Raises `ValueError` unless the shapes match and every weight is greater than 0.
    """

    move: Floats
    """(4, H, W) float32: the cost of leaving a cell to the east, south, west, north; `inf` if blocked."""
    wait: Floats
    """(H, W) float32: the cost of waiting or turning on a cell."""

    def __post_init__(self) -> None:
        """Copy, freeze and check the arrays."""
        move, wait = frozen(self.move, np.float32), frozen(self.wait, np.float32)
        if move.ndim != 3 or move.shape != (4, *wait.shape):
            raise ValueError(f"guidance graph: expected move (4, H, W) and wait (H, W), got {move.shape}, {wait.shape}")
        if not (move > 0).all() or not (wait > 0).all() or not np.isfinite(wait).all():
            raise ValueError("guidance graph: expected weights greater than 0, and finite ones for waiting")
        object.__setattr__(self, "move", move)
        object.__setattr__(self, "wait", wait)

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W)."""
        return self.wait.shape[0], self.wait.shape[1]

    @classmethod
    def uniform(cls, free: Bools) -> GuidanceGraph:
        """Return the graph in which every action costs 1, for the map `free` (H, W)."""
        return cls(np.where(open_edges(free), 1, np.inf), np.ones(free.shape))

    @classmethod
    def random(cls, free: Bools, rng: np.random.Generator, low: float = 0.1, high: float = 1.0) -> GuidanceGraph:
        """Sample every weight uniformly between `low` and `high`, as in the report's test."""
        move = rng.uniform(low, high, (4, *free.shape))
        return cls(np.where(open_edges(free), move, np.inf), rng.uniform(low, high, free.shape))

    @classmethod
    def crisscross(cls, free: Bools, along: float = 0.5, against: float = 1.0) -> GuidanceGraph:
        """Return alternating directions: even rows lead east, odd rows west, even columns north, odd columns south.

        Moves in the direction of their row or column cost `along`, other moves `against`, and waiting 1. This is the
        baseline of Zhang et al., *Guidance Graph Optimization for Lifelong MAPF*, IJCAI 2024.
        """
        rows, cols = np.indices(free.shape)
        move = np.full((4, *free.shape), against)
        move[Heading.EAST, rows % 2 == 0] = along
        move[Heading.WEST, rows % 2 == 1] = along
        move[Heading.NORTH, cols % 2 == 0] = along
        move[Heading.SOUTH, cols % 2 == 1] = along
        return cls(np.where(open_edges(free), move, np.inf), np.ones(free.shape))


def open_edges(free: Bools) -> Bools:
    """Return which moves on the map `free` (H, W) lead from a free cell to a free cell: (4, H, W), by heading."""
    height, width = free.shape
    padded = np.zeros((height + 2, width + 2), np.bool_)
    padded[1:-1, 1:-1] = free
    targets = [padded[1 + r : 1 + r + height, 1 + c : 1 + c + width] for r, c in HEADING_STEPS.tolist()]
    return np.stack(targets) & free
