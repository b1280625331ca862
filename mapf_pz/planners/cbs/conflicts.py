"""The conflicts of several agents' paths."""

from __future__ import annotations

from mapf_pz._internal.jit import Array, inlined, jit

STEP, FIRST, SECOND, SWAP, RAISED = range(5)
"""Columns of a conflict: the step, the two agents, whether they swap cells, and how many of the two agents have only
shortest paths with this conflict, so that to avoid it raises their cost."""


@jit
def find_conflicts(cells: Array, last: Array, widths: Array, conflicts: Array) -> int:
    """Return the number of conflicts, of which the first K are written.

    Args:
        cells: (L, N) int32: the cell of each agent after each step.
        last: (N,) int32: the last step after which each agent is on the map.
        widths: (L, N) int32: the number of cells that each agent's shortest paths can be on after each step.
        conflicts: (K, 5) int32: the conflicts, by step.
    """
    count = 0
    num_agents = cells.shape[1]
    for step in range(cells.shape[0]):
        for i in range(num_agents):
            if step > last[i]:
                continue
            for j in range(i + 1, num_agents):
                if step > last[j]:
                    continue
                swap = step > 0 and cells[step, i] == cells[step - 1, j] and cells[step, j] == cells[step - 1, i]
                if cells[step, i] != cells[step, j] and not (swap and cells[step, i] != cells[step - 1, i]):
                    continue
                # All conflicts are counted, as nodes of equal bounds are compared by their number, even if not all are
                # written.
                if count < conflicts.shape[0]:
                    is_swap = cells[step, i] != cells[step, j]
                    row = conflicts[count]
                    row[STEP], row[FIRST], row[SECOND], row[SWAP] = step, i, j, is_swap
                    row[RAISED] = _is_narrow(widths, step, i, is_swap) + _is_narrow(widths, step, j, is_swap)
                count += 1
    return count


@inlined
def _is_narrow(widths: Array, step: int, agent: int, is_swap: bool) -> bool:
    """Return whether all shortest paths of an agent have the same cell after a step, or make the same move."""
    return widths[step, agent] == 1 and (not is_swap or widths[step - 1, agent] == 1)
