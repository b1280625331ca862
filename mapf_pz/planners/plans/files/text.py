"""The text files of the PIBT and LaCAM tools: a header of `key=value` lines, then the cells of all agents at each step.

A cell is `(x,y)`, column first; for rotating agents, the heading is a third part, as mapf-visualizer reads it.
Source: github.com/Kei18/lacam (post_processing.cpp), pibt2 (solver.cpp) and mapf-visualizer (main.cpp, demo_2x2.txt).
"""

from __future__ import annotations

import io
import re
from array import array
from collections.abc import Iterator
from pathlib import Path
from reprlib import repr as shortened

import numpy as np

from mapf_pz._internal.arrays import Ints
from mapf_pz.errors import FormatError
from mapf_pz.instances.heading import Heading
from mapf_pz.instances.instance import Instance
from mapf_pz.planners.plans.files.planfile import PlanFile, PlanMetadata, Selection, one_goal_each
from mapf_pz.planners.plans.plan import Plan

HEADINGS = {
    "X_PLUS": Heading.EAST,
    "Y_PLUS": Heading.SOUTH,
    "X_MINUS": Heading.WEST,
    "Y_MINUS": Heading.NORTH,
}
"""The headings by name; y increases toward the south."""
MAX_ENTRIES = 1000
"""Maximum number of entries of a header."""
CLAIMS = {"soc": "sum of costs", "makespan": "makespan"}

_CELL = re.compile(rf"\((\d{{1,9}}),(\d{{1,9}})(?:,({'|'.join(HEADINGS)}))?\)(?:,|\Z)", re.ASCII)
_STEP = re.compile(r"(\d{1,9}):", re.ASCII)
_ENTRY = re.compile(r"(\w+)=(.*)")
_COUNT = re.compile(r"\d{1,9}", re.ASCII)


def parse_text(text: str, origin: str | Path, _: Selection) -> PlanFile:
    """Parse the text of a result file; raises `FormatError` with the name `origin` unless it holds a solution."""
    lines = enumerate((line.rstrip("\r\n") for line in io.StringIO(text)), 1)
    header, first = _header(lines, origin)
    cells, headings = array("i"), array("b")
    count = num_steps = 0
    for number, line in first:
        step = _STEP.match(line)
        if step is None or int(step[1]) != num_steps:
            raise FormatError(origin, f"expected '{num_steps}:' and cells, got {shortened(line)}", number)
        numbers, directions = _cells(line, step.end(), origin, number)
        count = count or len(numbers) // 2
        if len(numbers) != 2 * count or len(directions) != (count if headings or (directions and not num_steps) else 0):
            raise FormatError(origin, f"expected {count} cells, with headings for all cells or for none", number)
        cells.extend(numbers)
        headings.extend(directions)
        num_steps += 1
    if not num_steps:
        raise FormatError(origin, "expected a solution, got none")
    plan = Plan(
        np.array(cells).reshape(num_steps, count, 2)[..., ::-1],
        np.array(headings).reshape(num_steps, count) if headings else None,
    )
    given = {name: _header_cells(header, name, count, origin) for name in ("starts", "goals")}
    if given["starts"] is not None and not np.array_equal(given["starts"], plan.positions[0]):
        raise FormatError(origin, "expected the solution to start at the starts", header["starts"][0])
    claims = {
        claim: int(header[key][1])
        for key, claim in CLAIMS.items()
        if key in header and _COUNT.fullmatch(header[key][1])
    }
    if "sum of costs" in claims:  # in this format, an agent that never moves costs 0
        claims["sum of costs"] += plan.num_unmoved
    return PlanFile(plan, goals=given["goals"], claims=claims)


def format_text(plan: Plan, instance: Instance, metadata: PlanMetadata) -> str:
    """Return the text of a result file; raises `ValueError` if agents have several goals each."""
    goals = one_goal_each(instance.scenario.goals, "text")
    names = {int(heading): f",{name}" for name, heading in HEADINGS.items()}
    header = {
        "agents": plan.num_agents,
        "map_file": f"{instance.grid.name}.map",
        "solver": metadata.solver,
        "solved": 1,
        "soc": plan.sum_of_costs - plan.num_unmoved,
        "makespan": plan.makespan,
        "comp_time": round(metadata.seconds * 1000),
        "starts": _row(plan.positions[0], [""] * plan.num_agents),
        "goals": _row(goals, [""] * plan.num_agents),
        "solution": "",
    }
    lines = [f"{key}={' '.join(str(value).split())}" for key, value in header.items()]
    for step, cells in enumerate(plan.positions):
        headings = [""] * plan.num_agents
        if plan.headings is not None:
            headings = [names[heading] for heading in plan.headings[step].tolist()]
        lines.append(f"{step}:{_row(cells, headings)}")
    return "\n".join(lines) + "\n"


def _row(cells: Ints, headings: list[str]) -> str:
    return "".join(f"({col},{row}{heading})," for (row, col), heading in zip(cells.tolist(), headings, strict=True))


_Lines = Iterator[tuple[int, str]]


def _header(lines: _Lines, origin: str | Path) -> tuple[dict[str, tuple[int, str]], _Lines]:
    """Split off the header: the line number and value of each entry, and the nonempty lines of the solution."""
    header: dict[str, tuple[int, str]] = {}
    for number, line in lines:
        entry = _ENTRY.fullmatch(line)
        if entry is not None:
            header[entry[1]] = number, entry[2]
            if len(header) > MAX_ENTRIES:
                raise FormatError(origin, f"expected a header of at most {MAX_ENTRIES} entries", number)
        elif line.strip():
            return header, _filled(number, line, lines)
    return header, iter(())


def _filled(number: int, line: str, rest: _Lines) -> _Lines:
    yield number, line
    yield from ((number, line) for number, line in rest if line.strip())


def _cells(line: str, position: int, origin: str | Path, number: int) -> tuple[list[int], list[int]]:
    """Return the numbers x, y, x, y, ... and the headings in a line, from a position on."""
    numbers: list[int] = []
    headings: list[int] = []
    while position < len(line):
        cell = _CELL.match(line, position)
        if cell is None:
            got = shortened(line[position:])
            raise FormatError(origin, f"expected a cell (x,y), got {got}", number, position + 1)
        numbers += int(cell[1]), int(cell[2])
        if cell[3] is not None:
            headings.append(int(HEADINGS[cell[3]]))
        position = cell.end()
    if not numbers:
        raise FormatError(origin, "expected cells (x,y), got none", number)
    return numbers, headings


def _header_cells(header: dict[str, tuple[int, str]], name: str, count: int, origin: str | Path) -> Ints | None:
    """Return the cells (N, 2), [row, col], of a header entry, or None if there is no such entry."""
    if name not in header:
        return None
    number, value = header[name]
    numbers, _ = _cells(value, 0, origin, number)
    if len(numbers) != 2 * count:
        raise FormatError(origin, f"expected {count} cells as {name}, got {len(numbers) // 2}", number)
    return np.array(numbers).reshape(count, 2)[:, ::-1]
