"""The state of an environment that is rendered."""

from __future__ import annotations

from typing import NamedTuple

from mapf_pz._internal.arrays import Bools, Ints


class RenderState(NamedTuple):
    """What is rendered."""

    positions: Ints  # (N, 2) [row, col]
    headings: Ints | None  # (N,), None for agents without headings
    goals: Ints  # (N, 2) [row, col]
    active: Bools  # (N,)
    delayed: Bools  # (N,), whether it was delayed in the last step
