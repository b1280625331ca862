"""Headings and actions.

Headings and edge directions share one order: east, south, west, north.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np


class Heading(IntEnum):
    """Where an agent looks, and the direction of an edge; turning right adds one, modulo 4."""

    EAST = 0
    SOUTH = 1
    WEST = 2
    NORTH = 3


class Action(IntEnum):
    """The actions of `action_model="rotate"`: the report's order."""

    FORWARD = 0
    ROTATE_LEFT = 1
    ROTATE_RIGHT = 2
    WAIT = 3


class CardinalAction(IntEnum):
    """The actions of `action_model="cardinal"`: POGEMA's order."""

    WAIT = 0
    UP = 1
    DOWN = 2
    LEFT = 3
    RIGHT = 4


HEADING_STEPS = np.array([(0, 1), (1, 0), (0, -1), (-1, 0)], np.int32)  # (4, 2): (row, col) of one step per heading
