"""The file formats of the MovingAI benchmark: `.map` (free cells and obstacles) and `.scen` (starts and goals).

Files are treated as untrusted input, and written as in the benchmark. Only in these files, x is the column and y the
row.
"""

from __future__ import annotations

import io
import re
from array import array
from collections.abc import Iterable, Iterator
from itertools import islice
from pathlib import Path, PurePosixPath
from reprlib import repr as shortened

import numpy as np

from mapf_pz._internal.arrays import Bools, Ints
from mapf_pz._internal.atomic import write_whole
from mapf_pz._internal.text import read_text
from mapf_pz.errors import FormatError
from mapf_pz.instances.files.octile import octile_distances
from mapf_pz.instances.instance import Grid, Scenario

PASSABLE = ".GSE"
"""Characters of free cells: ground (two), swamp; in maps of the League of Robot Runners also stations (`E`) and shelves
(`S`) of warehouses."""
BLOCKED = "@OTW"
"""Characters of obstacles: out of bounds (two), trees, water."""
MAX_CELLS = 16_000_000
"""Maximum number of cells of a map; larger maps are rejected."""

_NUMBER = r"\d{1,9}"
_HEADER = {
    "'type octile'": r"type\s+octile\s*",
    "'height' and a number": r"height\s+(\d{1,18})\s*",
    "'width' and a number": r"width\s+(\d{1,18})\s*",
    "'map'": r"map\s*",
}
_VERSION = re.compile(r"version\s+1(\.0)?\s*")
_COLUMNS = {
    "bucket": _NUMBER,
    "map name": r"[^\t]+",
    "map width": f"({_NUMBER})",
    "map height": f"({_NUMBER})",
    "start x": f"({_NUMBER})",
    "start y": f"({_NUMBER})",
    "goal x": f"({_NUMBER})",
    "goal y": f"({_NUMBER})",
    "distance": r"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?",
}
_AGENT = re.compile(r"\t".join(_COLUMNS.values()), re.ASCII)


def read_map(path: str | Path) -> Grid:
    """Read a `.map` file; the map's name is that of the file.

    Raises:
        FileNotFoundError: The file does not exist.
        FormatError: The file is not a map.
    """
    return parse_map(read_text(path), path)


def parse_map(text: str, origin: str | Path) -> Grid:
    """Parse the text of the `.map` file `origin`; a second map after the first is ignored.

    Characters in `PASSABLE` are free cells, those in `BLOCKED` obstacles. Raises `FormatError` for anything else.
    """
    lines = _lines(text)
    height, width = _parse_header(lines, origin)
    first = len(_HEADER) + 1
    rows = list(islice(lines, height))
    free = parse_cells(rows, width, origin, first)
    if len(rows) < height:
        raise FormatError(origin, f"expected {height} rows, got {len(rows)}", first + len(rows))
    for number, line in enumerate(lines, first + height):
        if line.startswith("type "):
            break
        if line.strip():
            raise FormatError(origin, f"expected the end of the file after {height} rows", number, 1)
    return Grid(free, Path(origin).stem)


def map_rows(text: str, height: int) -> list[str]:
    """Return the `height` rows of the text of a `.map` file, which `parse_map` has checked."""
    return list(islice(_lines(text), len(_HEADER), len(_HEADER) + height))


def parse_cells(
    rows: Iterable[str],
    width: int,
    origin: str | Path,
    first_line: int,
    passable: str = PASSABLE,
    blocked: str = BLOCKED,
) -> Bools:
    """Parse rows of `width` characters into a (rows, width) array, True where the cell is free.

    Raises `FormatError` for a row of another length or with an unknown character; `first_line` is the first row's line.
    """
    unknown = re.compile(f"[^{re.escape(passable + blocked)}]")
    cells = bytearray()
    for line, row in enumerate(rows, first_line):
        if found := unknown.search(row):
            message = f"expected one of {passable}{blocked}, got {found[0]!r}"
            raise FormatError(origin, message, line, found.start() + 1)
        if len(row) != width:
            message = f"expected a row of {width} cells, got {len(row)}"
            raise FormatError(origin, message, line, min(len(row), width) + 1)
        cells += row.encode()
    return np.isin(np.frombuffer(cells, np.uint8), list(passable.encode())).reshape(-1, width)


def format_map(grid: Grid, blocked: str = "@") -> str:
    """Return the text of a `.map` file; raises `ValueError` unless `blocked`, the obstacles, is one of `BLOCKED`."""
    if len(blocked) != 1 or blocked not in BLOCKED:
        raise ValueError(f"blocked={blocked!r}: expected one of {', '.join(BLOCKED)}")
    height, width = grid.shape
    cells = np.full((height, width + 1), ord("\n"), np.uint8)
    cells[:, :-1] = np.where(grid.free, ord("."), ord(blocked))
    return f"type octile\nheight {height}\nwidth {width}\nmap\n{cells.tobytes().decode()}"


def write_map(grid: Grid, path: str | Path, blocked: str = "@") -> None:
    """Write a `.map` file, atomically."""
    write_whole(Path(path), format_map(grid, blocked).encode())


def read_scenario(path: str | Path, grid: Grid | None = None) -> Scenario:
    """Read a `.scen` file and, with a `grid`, check that it fits that map.

    Raises:
        FileNotFoundError: The file does not exist.
        FormatError: The file is not a scenario, or does not fit the map.
    """
    return parse_scenario(read_text(path), path, grid)


def parse_scenario(text: str, origin: str | Path, grid: Grid | None = None) -> Scenario:
    """Parse the text of the `.scen` file `origin`; raises `FormatError` as `read_scenario` does."""
    numbers = array("i")
    first = 1
    for number, line in enumerate(_lines(text.rstrip()), 1):
        agent = _AGENT.fullmatch(line)
        if agent is not None:
            numbers.extend(map(int, agent.groups()))
        elif number == 1 and _VERSION.fullmatch(line):
            first = 2
        else:
            raise _malformed_agent(line, origin, number)
    if not numbers:
        raise FormatError(origin, "expected a line for each agent, got none", first)
    table = np.array(numbers, np.int32).reshape(-1, 6)
    scenario = Scenario(table[:, [3, 2]], table[:, [5, 4]])
    sizes = table[:, [1, 0]]
    misfit = _first_misfit(sizes, scenario, grid)
    if misfit is not None:
        agent, column, message = misfit
        line = next(islice(_lines(text), first - 1 + agent, None))
        raise FormatError(origin, message, first + agent, _column_start(line, list(_COLUMNS).index(column)))
    return scenario


def parse_map_name(text: str) -> str:
    """Return the name of the map in the text of a `.scen` file, without folders and extension; empty if there is none.

    It is that of the first agent. Folders are separated by slashes or backslashes.
    """
    agents = (line.split("\t") for line in islice(_lines(text), 2) if _AGENT.fullmatch(line))
    return next((PurePosixPath(columns[1].replace("\\", "/")).stem for columns in agents), "")


def format_scenario(scenario: Scenario, grid: Grid) -> str:
    """Return the text of a `.scen` file, with the octile distances that the format requires.

    Raises `ValueError` for an agent that has several goals, whose start or goal is not a free cell of the map, or that
    cannot reach its goal.
    """
    if scenario.goals.ndim != 2:
        raise ValueError("a .scen file holds one goal for each agent: this scenario has several")
    if re.search(r"[\t\r\n]", grid.name):
        raise ValueError(f"map name {grid.name!r}: a .scen file cannot hold tabs or line ends in it")
    height, width = grid.shape
    misfit = _first_misfit(np.full((len(scenario), 2), grid.shape, np.int32), scenario, grid)
    if misfit is not None:
        raise ValueError(f"agent {misfit[0]}: {misfit[2]}")
    lines = ["version 1"]
    distances = octile_distances(grid.free, scenario.starts, scenario.goals).tolist()
    ends = zip(scenario.starts.tolist(), scenario.goals.tolist(), distances, strict=True)
    for agent, (start, goal, distance) in enumerate(ends):
        if distance == np.inf:
            raise ValueError(f"agent {agent}: no path leads from its start to its goal")
        columns = (int(distance / 4), f"{grid.name}.map", width, height, *start[::-1], *goal[::-1], f"{distance:.8f}")
        lines.append("\t".join(map(str, columns)))
    return "\n".join(lines) + "\n"


def write_scenario(scenario: Scenario, grid: Grid, path: str | Path) -> None:
    """Write a `.scen` file, atomically; raises `ValueError` as `format_scenario` does."""
    write_whole(Path(path), format_scenario(scenario, grid).encode())


def _lines(text: str) -> Iterator[str]:
    """Yield the lines lazily, so that a malicious file cannot take memory for millions of them."""
    return (line.rstrip("\r\n") for line in io.StringIO(text))


def _parse_header(lines: Iterator[str], origin: str | Path) -> tuple[int, int]:
    """Consume the header of `lines`, and return (H, W)."""
    sizes: list[int] = []
    for number, (expected, pattern) in enumerate(_HEADER.items(), 1):
        line = next(lines, "")
        match = re.fullmatch(pattern, line, re.ASCII)
        if match is None:
            raise FormatError(origin, f"expected {expected}, got {shortened(line)}", number, 1)
        sizes.extend(map(int, match.groups()))
        if 0 in sizes:
            raise FormatError(origin, f"expected {expected}, 1 or more", number, line.index("0") + 1)
    height, width = sizes
    if height * width > MAX_CELLS:
        raise FormatError(origin, f"expected at most {MAX_CELLS} cells, got {height} x {width}", 2)
    return height, width


def _malformed_agent(line: str, origin: str | Path, number: int) -> FormatError:
    """Return the error for a malformed line of an agent."""
    if number == 1 and line.startswith("version"):
        return FormatError(origin, f"expected 'version 1', got {shortened(line)}", number, 1)
    fields = line.split("\t")
    if len(fields) != len(_COLUMNS):
        message = f"expected {len(_COLUMNS)} columns separated by tabs, got {len(fields)}"
        return FormatError(origin, message, number, min(len(line) + 1, _column_start(line, len(_COLUMNS))))
    for index, (name, pattern) in enumerate(_COLUMNS.items()):
        if not re.fullmatch(pattern, fields[index], re.ASCII):
            message = f"expected the {name}, got {shortened(fields[index])}"
            return FormatError(origin, message, number, _column_start(line, index))
    raise AssertionError("a line whose columns are all valid is not malformed")


def _column_start(line: str, index: int) -> int:
    """Return the position, from 1, where the column `index` of a tab-separated line starts."""
    return 1 + sum(len(field) + 1 for field in line.split("\t")[:index])


def _first_misfit(sizes: Ints, scenario: Scenario, grid: Grid | None) -> tuple[int, str, str] | None:
    """Return an agent that does not fit its map size in `sizes` (M, 2) or the `grid`, as (agent, column, message)."""
    if grid is not None:
        fits: Bools = np.all(sizes == grid.shape, axis=1)
        if not fits.all():
            agent = int(np.argmin(fits))
            height, width = grid.shape
            expected = f"expected the size of map {grid.name!r}, width {width} and height {height}"
            return agent, "map width", f"{expected}, got {sizes[agent, 1]} and {sizes[agent, 0]}"
    for what, cells in (("start", scenario.starts), ("goal", scenario.goals)):
        usable: Bools = np.all((cells >= 0) & (cells < sizes), axis=1)
        if grid is not None:
            usable[usable] = grid.free[cells[usable, 0], cells[usable, 1]]
        if not usable.all():
            agent = int(np.argmin(usable))
            row, col = cells[agent].tolist()
            return agent, f"{what} x", f"expected the {what} to be a free cell of the map, got x={col}, y={row}"
    return None
