"""`GuidanceGraph`: the edge weights of a map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mapf_pz._internal.arrays import Bools, EqualByValue, Floats, Ints, frozen
from mapf_pz.guidance.edges import of_target, open_edges, opposite_edges
from mapf_pz.instances.heading import Heading

LOW, HIGH = 0.1, 1.0
"""Default range of random weights."""
ALONG, AGAINST = 0.5, 1.0
"""Default weights of moves along a direction, and of other moves."""
CONTRAFLOW, CONGESTION = 1.0, 0.0
"""Default weights of the terms of `GuidanceGraph.traffic`. With PIBT, the second one lowered the throughput."""
ARROWS = {">": Heading.EAST, "v": Heading.SOUTH, "<": Heading.WEST, "^": Heading.NORTH}
"""Characters of directions in drawings of highways."""
NO_ARROW = ".@T"
"""Characters of cells without a direction in drawings of highways."""


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
        move, wait = (frozen(getattr(self, name), np.float32, f"{name} weights") for name in ("move", "wait"))
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

    def on_map(self, free: Bools) -> GuidanceGraph:
        """Return the graph with only the weights that have a meaning on the map `free` (H, W).

        Moves that the map does not allow become `inf`, and waiting on obstacles 1. Raises `ValueError` if the map has
        another shape.
        """
        if free.shape != self.shape:
            raise ValueError(f"guidance graph of shape {self.shape}: the map's shape is {free.shape}")
        return GuidanceGraph(np.where(open_edges(free), self.move, np.inf), np.where(free, self.wait, 1))

    @classmethod
    def uniform(cls, free: Bools) -> GuidanceGraph:
        """Return the graph in which every action costs 1, for the map `free` (H, W)."""
        return cls(np.where(open_edges(free), 1, np.inf), np.ones(free.shape))

    @classmethod
    def random(cls, free: Bools, rng: np.random.Generator, low: float = LOW, high: float = HIGH) -> GuidanceGraph:
        """Sample every weight uniformly between `low` and `high`, as in the report's test."""
        move = rng.uniform(low, high, (4, *free.shape))
        return cls(np.where(open_edges(free), move, np.inf), rng.uniform(low, high, free.shape))

    @classmethod
    def crisscross(cls, free: Bools, along: float = ALONG, against: float = AGAINST) -> GuidanceGraph:
        """Return alternating directions: even rows lead east, odd rows west, even columns north, odd columns south.

        Moves in the direction of their row or column cost `along`, other moves `against`, and waiting 1. This is the
        baseline of Zhang et al., *Guidance Graph Optimization for Lifelong MAPF*, IJCAI 2024.
        """
        rows, cols = np.indices(free.shape)
        move = np.full((4, *free.shape), against, np.float64)
        move[Heading.EAST, rows % 2 == 0] = along
        move[Heading.WEST, rows % 2 == 1] = along
        move[Heading.NORTH, cols % 2 == 0] = along
        move[Heading.SOUTH, cols % 2 == 1] = along
        return cls(np.where(open_edges(free), move, np.inf), np.ones(free.shape))

    @classmethod
    def highway(cls, free: Bools, arrows: str, along: float = ALONG, against: float = AGAINST) -> GuidanceGraph:
        """Return a graph of highways, which are drawn with arrows.

        From a cell with an arrow, the move in its direction costs `along` and the other moves `against`. All other
        actions cost 1. Highways were introduced by Cohen, Uras and Koenig, *Feasibility Study: Using Highways for
        Bounded-Suboptimal Multi-Agent Path Finding*, SoCS 2015.

        Args:
            free: The map (H, W).
            arrows: H lines of W characters: `>`, `v`, `<`, `^`, or one of `.@T` for no direction. Empty lines before
                and after them are ignored.
            along: Weight of moves in the direction of an arrow, greater than 0.
            against: Weight of other moves from a cell with an arrow, greater than 0.

        Raises:
            ValueError: The size or a character of the drawing is wrong, or a weight is not greater than 0.
        """
        directions = _directions(arrows, free.shape)
        move = np.where(directions >= 0, against, 1.0)[None].repeat(4, axis=0)
        for heading in Heading:
            move[heading, directions == heading] = along
        return cls(np.where(open_edges(free), move, np.inf), np.ones(free.shape))

    @classmethod
    def traffic(
        cls, free: Bools, moves: Ints | Floats, contraflow: float = CONTRAFLOW, congestion: float = CONGESTION
    ) -> GuidanceGraph:
        """Return a graph in which moves against the traffic, and optionally moves into busy cells, cost more.

        The move `e` from a cell to the cell `v` costs

            1 + contraflow * U[opposite of e] / (U[e] + U[opposite of e]) + congestion * V[v] / max V

        where `U` counts moves and `V` the moves into a cell; a quotient is 0 where nothing was counted. Waiting costs
        1. The terms are those of Chen et al., *Traffic Flow Optimisation for Lifelong Multi-Agent Path Finding*, AAAI
        2024, as shares instead of counts, so that weights do not depend on the length of the recording.

        Args:
            free: The map (H, W).
            moves: (4, H, W), 0 or more: how often the agents left each cell to the east, south, west, north, as
                `count_moves` returns. Moves that the map does not allow are ignored.
            contraflow: Weight of the first term, 0 or more.
            congestion: Weight of the second term, 0 or more.

        Raises:
            ValueError: The shape is wrong, or a number is negative or not finite.
        """
        if np.shape(moves) != (4, *free.shape):
            raise ValueError(f"moves: expected the shape {(4, *free.shape)}, got {np.shape(moves)}")
        for name, value in (("moves", moves), ("contraflow", contraflow), ("congestion", congestion)):
            if not (np.isfinite(value) & (np.asarray(value) >= 0)).all():
                raise ValueError(f"{name}: expected numbers 0 or more")
        edges = open_edges(free)
        used = np.where(edges, moves, 0).astype(np.float64)
        opposite = opposite_edges(used)
        entered = opposite.sum(axis=0)  # as often as the opposite edges of those that leave the cell were used
        both, most = used + opposite, max(entered.max(), 1)
        share = np.divide(opposite, both, out=np.zeros_like(both), where=both > 0)
        cost = 1 + contraflow * share + congestion * of_target(entered) / most
        return cls(np.where(edges, cost, np.inf), np.ones(free.shape))


def _directions(arrows: str, shape: tuple[int, int]) -> Ints:
    """Return the heading of each arrow, (H, W) int64, -1 for none; raises `ValueError` as `GuidanceGraph.highway`."""
    lines = arrows.strip("\r\n").splitlines()
    height, width = shape
    if len(lines) != height:
        raise ValueError(f"arrows: expected {height} lines, got {len(lines)}")
    directions = np.full(shape, -1)
    for row, line in enumerate(lines):
        if len(line) != width:
            raise ValueError(f"arrows: expected {width} characters in row {row}, got {len(line)}")
        for col, character in enumerate(line):
            if character not in ARROWS and character not in NO_ARROW:
                expected = f"expected one of {''.join(ARROWS)}{NO_ARROW}"
                raise ValueError(f"arrows: {expected} in [row {row}, col {col}], got {character!r}")
            directions[row, col] = ARROWS.get(character, -1)
    return directions
