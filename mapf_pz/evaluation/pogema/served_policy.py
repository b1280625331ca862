"""A policy that a program in another Python environment asks for actions, over lines of JSON.

A request is `{"map": ["..#", ...], "positions": [[row, col], ...], "goals": [[row, col], ...]}`, with the map only in
the first step of an episode, in which `.` is a free cell. The reply is `{"actions": [...]}`, numbers of
`CardinalAction`, or `{"error": "..."}`.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from mapf_pz._internal.arrays import Bools, Ints
from mapf_pz._internal.json import are_whole, list_member, parse_object
from mapf_pz.errors import FormatError
from mapf_pz.evaluation.pogema.pogema import InPogema


def replies(policy: InPogema, requests: Iterable[str]) -> Iterator[str]:
    """Yield a reply, a line without its end, to each request."""
    server = _Server(policy)
    for number, line in enumerate(requests, start=1):
        yield json.dumps(server.reply(line, f"request {number}"))


class _Server:
    """Keeps the map of an episode between requests."""

    def __init__(self, policy: InPogema) -> None:
        self._policy = policy
        self._free: Bools | None = None

    def reply(self, line: str, origin: str) -> dict[str, Any]:
        """Return the actions, or an error."""
        try:
            request = parse_object(line, origin)
            if "map" in request:
                self._free = _free(request["map"])
                self._policy.reset_states()
            if self._free is None:
                raise ValueError("expected a map in the first request")
            positions, goals = (_cells(request, name, origin) for name in ("positions", "goals"))
            return {"actions": self._policy.act_at(self._free, positions, goals)}
        except (ValueError, RuntimeError) as error:
            return {"error": str(error)}


def _free(rows: Any) -> Bools:
    """Return the free cells of a map."""
    lengths = {len(row) if isinstance(row, str) else 0 for row in rows} if isinstance(rows, list) else set[int]()
    if len(lengths) != 1 or 0 in lengths:
        raise ValueError("map: expected a list of strings of the same length")
    return np.array([list(row) for row in rows]) == "."


def _cells(request: dict[str, Any], name: str, origin: str) -> Ints:
    """Return the cells (N, 2) of a request's member."""
    cells = list_member(request, name, origin, least=1)
    if not all(are_whole(cell) and len(cell) == 2 for cell in cells):
        raise FormatError(origin, f"expected {name!r} to be a list of [row, col]")
    return np.array(cells)
