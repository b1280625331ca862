"""States of episodes as arrays, which can be stored, and from which a simulator continues."""

from __future__ import annotations

from typing import NamedTuple

from mapf_pz._internal.arrays import Bools, Floats, Ints


class States(NamedTuple):
    """The states of E episodes of N agents that stay on the map: what observations depend on."""

    free: Bools
    """(E, H, W): the maps, True where a cell is free."""
    weight: Floats
    """(E, 5, H, W) float32: the guidance graph, if it is random: weights of leaving cells in the directions of
    `Heading` and, last, of waiting. Otherwise (E, 0, H, W)."""
    time: Ints
    """(E,) int32: steps taken."""
    agents: Ints
    """(E, N, 5) int32: the numbers `row * W + col` of the agent's cell and of its goal, its heading, whether it was
    delayed in the last step, and in how many more steps it is delayed."""
    history: Ints
    """(E, N, L, 2) int8: the last L actions, newest first, and whether the agent moved; action -1: none."""


FIELDS = ("cell", "goal", "heading", "delayed", "delay")
"""The columns of `States.agents`: fields of `AGENT`."""
