"""Headings and actions.

Headings and directions of edges have the same order: east, south, west, north.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np


class Heading(IntEnum):
    """The heading of an agent, or the direction of an edge; a right turn adds 1 modulo 4."""

    EAST = 0
    SOUTH = 1
    WEST = 2
    NORTH = 3


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


HEADING_STEPS = np.array([(0, 1), (1, 0), (0, -1), (-1, 0)], np.int32)  # (4, 2): the (row, col) step in each heading
