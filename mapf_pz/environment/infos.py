"""The infos of the PettingZoo environment, which are built when they are first read."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapf_pz._internal.arrays import Ints

AgentInfo = dict[str, Any]


class Infos(dict[str, AgentInfo]):
    """A dictionary of the agents' infos, plain dictionaries; copies of it and unpickled ones are plain as well.

    Most programs read few infos, and building them takes longer than a step. The values are those of the step that
    returned them, whenever they are read.
    """

    __slots__ = ("_source",)

    def __init__(self, names: list[str], rows: slice | list[int], agents: NDArray[np.void], action_mask: Ints) -> None:
        """Keep what the infos of the agents `names` are built from.

        Args:
            names: Names of the agents that have infos.
            rows: Their indices.
            agents: The records of all agents, (N,) AGENT; they are copied.
            action_mask: Their action masks, (N, A) int8, which are not copied.
        """
        # NumPy copies bytes much faster than records.
        self._source: Any = (names.copy(), rows, np.frombuffer(agents.tobytes(), agents.dtype), action_mask)

    def fill(self) -> None:
        """Build all infos, unless they have been built."""
        if self._source is not None:
            super().update(_infos(*self._source))
            self._source = None

    def __reduce__(self) -> tuple[Any, ...]:
        """Return what `copy` and `pickle` make a plain dictionary of."""
        return dict, (dict(self),)


def _infos(
    names: list[str], rows: slice | list[int], agents: NDArray[np.void], action_mask: Ints
) -> dict[str, AgentInfo]:
    moved = agents["cell"] != agents["was_cell"]
    flags = (agents["at_goal"], agents["arrived"], agents["blocked"], moved)
    numbers = (column[rows].tolist() for column in (*(flag.view(np.int8) for flag in flags), agents["arrivals"]))
    return {
        name: {
            "action_mask": mask,
            "at_goal": at_goal,
            "arrived": arrived,
            "blocked": blocked,
            "arrivals": arrivals,
            "moved": moves,
        }
        for name, mask, at_goal, arrived, blocked, moves, arrivals in zip(
            names, action_mask[rows], *numbers, strict=True
        )
    }


def _after_filling(method: Callable[..., Any]) -> Callable[..., Any]:
    """Return a method of `dict` that fills the infos first."""

    @wraps(method)
    def call(self: Infos, *arguments: Any, **keywords: Any) -> Any:
        self.fill()
        return method(self, *arguments, **keywords)

    return call


_READS_NOTHING = {"__new__", "__init__", "__getattribute__", "__class_getitem__", "__sizeof__", "fromkeys"}
for _name, _method in vars(dict).items():
    if callable(_method) and _name not in _READS_NOTHING:
        setattr(Infos, _name, _after_filling(_method))
