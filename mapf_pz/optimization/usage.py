"""How often the edges of a map were used in an episode."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mapf_pz._internal.arrays import Floats, Ints
from mapf_pz._internal.jit import Array, jit


@dataclass(frozen=True, eq=False)
class Usage:
    """Counts of moves and waits by cell."""

    moves: Floats
    """(4, H, W): how often an agent left the cell to the east, south, west, north."""
    waits: Floats
    """(H, W): how often an agent stayed on the cell, waiting or turning, except at its goal."""

    @classmethod
    def empty(cls, shape: tuple[int, int]) -> Usage:
        """Return counts of 0 for a map of `shape` (H, W)."""
        return cls(np.zeros((4, *shape)), np.zeros(shape))

    def add(self, agents: Ints) -> None:
        """Count the latest step of `agents` (N,), records of `mapf_pz.simulator.kernels.state.AGENT`."""
        _add(agents, self.waits.shape[1], self.moves.reshape(4, -1), self.waits.reshape(-1))


@jit
def _add(agents: Array, width: int, moves: Array, waits: Array) -> None:
    for agent in agents:
        step = agent.cell - agent.was_cell
        if not agent.was_active:
            continue
        if step == 0:
            waits[agent.cell] += agent.cell != agent.goal  # resting on the goal is not waiting
        elif step == width:  # first, since on a map of one column it is 1
            moves[1, agent.was_cell] += 1
        elif step == -width:
            moves[3, agent.was_cell] += 1
        else:
            moves[0 if step == 1 else 2, agent.was_cell] += 1
