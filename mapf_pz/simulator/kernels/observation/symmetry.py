"""The symmetries of the grid: a state that is turned by quarters or mirrored is another state of the same kind.

A channel and a feature state what a symmetry does to them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mapf_pz._internal.arrays import Floats, Ints
from mapf_pz.instances.heading import HEADING_STEPS

_TURN, _MIRROR = np.array([(0, -1), (1, 0)]), np.diag([1, -1])  # of a step (rows, columns)
_CARDINAL_ACTIONS = np.array([(0, 0), (-1, 0), (1, 0), (0, -1), (0, 1)])  # the step of each `CardinalAction`
_TURNING_ACTIONS = np.array([(-1, 0), (0, -1), (0, 1), (0, 0)])  # of each `Action`: ahead, or to where the agent turns


@dataclass(frozen=True)
class Symmetry:
    """A map is mirrored left-right or not, and then turned to the left by quarters.

    The properties say what becomes of whatever is on the map, seen or done.
    """

    mirrored: bool
    """Whether left and right change places, first."""
    quarters: int
    """By how many quarters the map is turned: 0 to 3."""
    shape: tuple[int, int]
    """(H, W) of the map as it was."""
    cardinal: bool
    """Whether actions are cardinal; then agents do not turn, and face north all the time."""
    egocentric: bool
    """Whether the agent's heading is up in its view; then a view does not turn with the map."""

    @property
    def on_map(self) -> Ints:
        """(2, 2): the matrix of a step (rows, columns) on the map."""
        return _matrix(self.mirrored, self.quarters)

    @property
    def in_view(self) -> Ints:
        """(2, 2): the matrix of a step (rows, columns) in the view."""
        return _matrix(self.mirrored, 0 if self.egocentric else self.quarters)

    @property
    def origin(self) -> Ints:
        """(2,): where the step `on_map` from row 0, column 0 starts, so that all cells are on the map."""
        return np.minimum(self.on_map, 0) @ (1 - np.array(self.shape))

    @property
    def new_shape(self) -> Ints:
        """(2,): H and W of the map as it is then."""
        return np.abs(self.on_map) @ np.array(self.shape)

    @property
    def directions(self) -> Ints:
        """(4,): what becomes of each direction in the view: up, right, down, left, or east, south, west, north."""
        return _permutation(np.roll(HEADING_STEPS, 1, axis=0) if self.egocentric else HEADING_STEPS, self.in_view)

    @property
    def headings(self) -> Ints:
        """(4,): what becomes of each `Heading` of an agent."""
        return np.arange(4) if self.cardinal else _permutation(HEADING_STEPS, self.on_map)

    @property
    def headings_in_view(self) -> Ints:
        """(4,): what becomes of each heading of an agent in view, relative to the direction that is up."""
        return np.arange(4) if self.cardinal else self.directions

    @property
    def up(self) -> Ints:
        """(4,): what becomes of each `Heading` that is up in the view."""
        return self.headings if self.egocentric else np.arange(4)

    @property
    def actions(self) -> Ints:
        """(A,): what becomes of each action."""
        if self.cardinal:
            return _permutation(_CARDINAL_ACTIONS, self.on_map)
        return _permutation(_TURNING_ACTIONS, _matrix(self.mirrored, 0))


def unchanged(symmetry: Symmetry, size: int) -> Floats:
    """Return the matrix (F, F) of a feature of `size` F that no symmetry changes."""
    return np.eye(size)


def one_of(becomes: Ints) -> Floats:
    """Return the matrix (n, n) of one of n numbers that is 1, such as a heading, each of which becomes another."""
    return np.eye(len(becomes))[:, becomes]


def block_diagonal(*blocks: Ints | Floats) -> Floats:
    """Return the matrix of numbers that follow each other, from the square matrix of each part."""
    whole, at = np.zeros((sum(map(len, blocks)),) * 2), 0
    for block in blocks:
        whole[at : at + len(block), at : at + len(block)] = block
        at += len(block)
    return whole


def _matrix(mirrored: bool, quarters: int) -> Ints:
    """Return the matrix (2, 2) of a step (rows, columns)."""
    return np.linalg.matrix_power(_TURN, quarters) @ (_MIRROR if mirrored else np.eye(2, dtype=int))


def _permutation(steps: Ints, matrix: Ints) -> Ints:
    """Return for each of some steps the number of the one that it becomes."""
    return np.array([np.flatnonzero((steps == matrix @ step).all(1)).item() for step in steps])
