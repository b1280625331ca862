"""The tasks that are known to a scheduler, as in the League of Robot Runners since 2024.

A number of tasks is revealed. Each agent has at most one of them, and visits its errands in order. When a task is
finished, the next one is revealed. A task that was started, which means that its first errand was visited, stays with
its agent.
"""

from __future__ import annotations

import numpy as np

from mapf_pz._internal.arrays import Bools, Floats, Ints
from mapf_pz.instances.files.lorr import LorrProblem

NONE = -1


class TaskPool:
    """The revealed tasks, and the agents that carry them out."""

    def __init__(self, problem: LorrProblem, num_revealed: int) -> None:
        """Reveal the first tasks.

        Args:
            problem: The tasks. After the last one, they start over.
            num_revealed: K, the number of tasks that are revealed at any time; at least the number of agents.

        Raises `ValueError` for a smaller number.
        """
        if num_revealed < problem.team_size:
            raise ValueError(f"num_revealed={num_revealed}: expected at least {problem.team_size}, one for each agent")
        self._problem = problem
        self.tasks: Ints = np.arange(num_revealed)
        """(K,) int64: the number of each revealed task."""
        self.owner: Ints = np.full(num_revealed, NONE)
        """(K,) int64: the agent of each revealed task; -1: none."""
        self.errand: Ints = np.zeros(num_revealed, np.int64)
        """(K,) int64: the number of errands of each revealed task that were visited."""
        self._lengths: Floats = np.array([self._length(place) for place in range(num_revealed)], np.float32)
        self.num_finished = 0
        """Number of tasks that were finished."""

    @property
    def started(self) -> Bools:
        """(K,) bool: whether each revealed task was started."""
        return self.errand > 0

    def next_cells(self) -> Ints:
        """Return the next errand of each revealed task: (K, 2), [row, col]."""
        errands = [self._problem.task(task)[at] for task, at in zip(self.tasks, self.errand, strict=True)]
        return np.array(errands)

    def lengths(self) -> Floats:
        """Return the length (K,) of the rest of each task: the sum of Manhattan distances from errand to errand."""
        return self._lengths.copy()

    def _length(self, place: int) -> int:
        errands = self._problem.task(int(self.tasks[place]))[self.errand[place] :]
        return int(np.abs(np.diff(errands, axis=0)).sum())

    def assign(self, places: Ints) -> None:
        """Give each agent a revealed task: `places` (N,), each in 0 to K - 1; raises `ValueError` if not allowed."""
        if len(np.unique(places)) < len(places):
            raise ValueError("assignment: expected a different task for each agent")
        owner = np.full_like(self.owner, NONE)
        owner[places] = np.arange(len(places))
        if (owner != self.owner)[self.started].any():
            raise ValueError("assignment: expected tasks that were started to stay with their agents")
        self.owner = owner

    def visit(self, arrived: Bools) -> None:
        """Record that the agents `arrived` (N,) are at their tasks' next errands. Finished tasks are replaced."""
        for place in np.flatnonzero(self.owner != NONE):
            if not arrived[self.owner[place]]:
                continue
            self.errand[place] += 1
            if self.errand[place] == len(self._problem.task(self.tasks[place])):
                self.num_finished += 1
                self.tasks[place] = self.tasks.max() + 1
                self.owner[place], self.errand[place] = NONE, 0
            self._lengths[place] = self._length(int(place))
