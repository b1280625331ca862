"""Costs that the MAPF tracker knows for scenarios of the MovingAI benchmark: lower bounds and the best known costs.

They are sums of costs of cardinal agents, in the files `costs/tracker-bounds-MAP.csv` of the folders of benchmark data:
exports of tracker.pathfinding.ai with the columns of github.com/J-morag/MAPF, `Analysis/tracker_bounds`.
"""

from __future__ import annotations

import csv
import io
import math
import re
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from mapf_pz._internal.text import read_text
from mapf_pz.errors import FormatError
from mapf_pz.instances.library import benchmark_file

_SCENARIO = re.compile(r"(.+)-(even|random)-(\d+)")
_COLUMNS = ("scen_type", "type_id", "agents", "lower_cost", "solution_cost")


class KnownCost(NamedTuple):
    """What is known about the sum of costs of a scenario's first N agents."""

    lower: int
    """A lower bound; 0 if none is known."""
    best: int | None
    """The best known cost; None if no solution is known."""


def known_cost(scenario: str, num_agents: int) -> KnownCost:
    """Return what the tracker knows about the first agents of a scenario; nothing if its files are not available.

    A lower bound for fewer agents is also one for more agents, so the largest of them is returned.

    Args:
        scenario: the name of a scenario of the benchmark, such as `random-32-32-20-even-1`; any other is not known.
        num_agents: number of agents N.

    Raises:
        FormatError: the file of the scenario's map is malformed.
    """
    named = _SCENARIO.fullmatch(scenario)
    if named is None:
        return KnownCost(0, None)
    map, kind, number = named.groups()
    try:
        file = benchmark_file(f"costs/tracker-bounds-{map}.csv")
    except FileNotFoundError:
        return KnownCost(0, None)
    lower, best = 0, None
    for agents, bound, cost in _rows(file, kind, int(number)):
        if agents <= num_agents:
            lower = max(lower, bound)
        if agents == num_agents:
            best = cost
    return KnownCost(lower, best)


_Row = tuple[int, int, int | None]
"""A number of agents, the lower bound, and the best known cost."""


def _rows(file: Path, kind: str, number: int) -> list[_Row]:
    """Return the rows of a scenario."""
    table = _table(file, file.stat().st_mtime_ns)
    found = (_row(row, number, file, line) for line, row in table if row["scen_type"] == kind)
    return [row for row in found if row is not None]


def _row(row: dict[str, str], number: int, file: Path, line: int) -> _Row | None:
    """Return the numbers of a row, or None if it is of another scenario."""
    try:
        if int(row["type_id"]) != number:
            return None
        # Bounds can be fractions, and costs are whole numbers.
        lower, best = math.ceil(float(row["lower_cost"] or 0)), row["solution_cost"]
        return int(row["agents"]), lower, int(best) if best else None
    except (ValueError, TypeError, OverflowError) as error:
        raise FormatError(file, f"expected numbers of agents and costs: {error}", line) from None


@lru_cache(maxsize=4)  # suites look up many scenarios of the same map
def _table(file: Path, _modified: int) -> list[tuple[int, dict[str, str]]]:
    """Return the line numbers and the values of all rows of a file that was modified at this time."""
    reader = csv.DictReader(io.StringIO(read_text(file).removeprefix("\ufeff"), newline=""))
    missing = [name for name in _COLUMNS if name not in (reader.fieldnames or ())]
    if missing:
        raise FormatError(file, f"expected the columns {', '.join(missing)}", 1)
    try:
        return [(reader.line_num, row) for row in reader]
    except csv.Error as error:
        raise FormatError(file, f"expected numbers of agents and costs: {error}", reader.line_num) from None
