"""Headings of agents, which are also the directions of edges: east, south, west, north."""

from __future__ import annotations

from enum import IntEnum

import numpy as np


class Heading(IntEnum):
    """The heading of an agent, or the direction of an edge; a right turn adds 1 modulo 4."""

    EAST = 0
    SOUTH = 1
    WEST = 2
    NORTH = 3


HEADING_STEPS = np.array([(0, 1), (1, 0), (0, -1), (-1, 0)], np.int32)  # (4, 2): the (row, col) step in each heading
