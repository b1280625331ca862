"""Problems of the League of Robot Runners, 2023 to 2026: a map, the robots' starts, and their tasks.

A problem is a JSON file that names three other files. Cells are numbers, `row * width + col`; robots start facing east.
Source: github.com/MAPF-Competition/Start-Kit and Benchmark-Archive.
"""

from __future__ import annotations

import io
import json
import math
import re
import warnings
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from reprlib import repr as shortened
from typing import Any

import numpy as np

from mapf_pz._internal.arrays import Ints, frozen
from mapf_pz._internal.json import JsonObject, named_file, parse_object, text_member, whole_number
from mapf_pz._internal.text import read_text
from mapf_pz.errors import FormatError
from mapf_pz.instances.delays import NORMAL_DEVIATION, Delays
from mapf_pz.instances.files.movingai import format_map, read_map
from mapf_pz.instances.heading import Heading
from mapf_pz.instances.instance import Grid, Instance, Scenario
from mapf_pz.instances.place import check_reachable

ROUND_ROBIN, ENTRANT = "roundrobin", "entrant"
STRATEGIES = (ROUND_ROBIN, "roundrobin_fixed", "greedy", ENTRANT)
"""Strategies of task assignment. `entrant`: since 2024, an entrant's scheduler decides, and files name no strategy."""
DELAYS = "delayConfig"
"""The member of the delays of 2026."""
DURATIONS = {"uniform": "uniform", "gaussian": "normal"}
"""The names of distributions in problem files, and those of `Delays`."""
MODELED = ("mapFile", "agentFile", "taskFile", "teamSize", "taskAssignmentStrategy", "version")
"""The members of a problem file that this package supports."""
NEUTRAL = {"numTasksReveal": 1, "agentCounter": 1, "agentSize": 1}
"""Values of other members that have no effect."""
MAX_PROBLEM_CHARACTERS = 100_000
"""Maximum length of a problem's JSON file; longer ones are rejected."""
MAX_ERRANDS_PER_TASK = 100
"""Maximum number of errands per task; files with longer tasks are rejected."""
MAX_REVEAL = 1000
"""Maximum number of revealed tasks per robot; problems with more are rejected."""
MAX_GOALS = 16_000_000
"""Maximum total number of goals of an instance; larger ones are rejected."""

_NUMBER = r"\d{1,9}"


@dataclass(frozen=True, eq=False)
class LorrProblem:
    """A problem: M robots and K tasks, each of one or more errands that a robot visits in order."""

    grid: Grid
    """The map."""
    starts: Ints
    """(M, 2) int32, [row, col]."""
    errands: Ints
    """(E, 2) int32, [row, col]: the errands of all tasks, concatenated."""
    offsets: Ints
    """(K + 1,) int64: task `k` is `errands[offsets[k]:offsets[k + 1]]`."""
    strategy: str
    """One of `STRATEGIES`."""
    version: str | None
    """The version in the file, such as `2024 LoRR`; None in 2023."""
    reveal: float = 1.0
    """Number of revealed tasks per robot at any time, `numTasksReveal`."""
    delays: Delays | None = None
    """The robots' delays, `delayConfig`, whose ticks are steps; None if there are none."""
    name: str = "problem"
    """The file name without its extension."""
    not_modeled: tuple[str, ...] = ()
    """Members of the file that instances do not represent, such as `agentCounter` (ticks per action) of 2026, or
    `numTasksReveal` (number of tasks revealed in advance) since 2024."""

    @property
    def team_size(self) -> int:
        """M, the number of robots."""
        return len(self.starts)

    @property
    def num_revealed(self) -> int:
        """Number of tasks that are revealed at any time, one or more for each robot."""
        return max(self.team_size, int(self.reveal * self.team_size))

    @property
    def num_tasks(self) -> int:
        """K, the number of tasks."""
        return len(self.offsets) - 1

    def task(self, number: int) -> Ints:
        """Return the errands of a task, (L, 2), [row, col]; numbers beyond the last task start over."""
        k = number % self.num_tasks
        return self.errands[self.offsets[k] : self.offsets[k + 1]]

    def instance(self, goals_per_agent: int | None = None) -> Instance:
        """Return the lifelong instance: all robots face east, and each has a fixed sequence of goals.

        Robot `i` gets the tasks `i`, `i + M`, `i + 2M` and so on, modulo the number of tasks. This is the
        competition's `roundrobin` of 2023. Since 2024 an entrant's scheduler assigns tasks (see
        `mapf_pz.planners.scheduling`), so for these problems it is only a substitute, in which a robot visits
        all errands of a task in order. Warns about `not_modeled` members, since results are then not comparable
        with the competition's.

        Args:
            goals_per_agent: L, the number of goals; None: the smallest number of goals that any robot has before its
                tasks repeat.

        Raises:
            ValueError: The strategy gives no fixed sequence, because it depends on which robot is free first or runs
                out of tasks; or there are more than `MAX_GOALS` goals in total, or one that its robot cannot reach.
        """
        if self.strategy not in (ROUND_ROBIN, ENTRANT):
            expected = f"expected {ROUND_ROBIN!r}, or none since 2024"
            raise ValueError(f"strategy {self.strategy!r} gives robots no fixed sequence of goals: {expected}")
        self.warn_not_modeled()
        period = self.num_tasks // math.gcd(self.num_tasks, self.team_size)
        tasks_per_agent = period if goals_per_agent is None else min(period, goals_per_agent)
        self._check_goals(tasks_per_agent if goals_per_agent is None else goals_per_agent)
        given = np.add.outer(np.arange(self.team_size), np.arange(tasks_per_agent) * self.team_size) % self.num_tasks
        lengths = np.diff(self.offsets)
        count = goals_per_agent
        if count is None:
            count = int(lengths[given].sum(axis=1).min())
            self._check_goals(count)
        goals = np.empty((self.team_size, count, 2), np.int32)
        for agent, tasks in enumerate(given):
            before = lengths[tasks].cumsum() - lengths[tasks]
            errands = np.repeat(self.offsets[tasks] - before, lengths[tasks])
            errands += np.arange(len(errands))
            goals[agent] = self.errands[errands[np.arange(count) % len(errands)]]
        headings = np.full(self.team_size, Heading.EAST)
        instance = Instance(self.grid, Scenario(self.starts, goals), headings, self.delays)
        check_reachable(instance)
        return instance

    def warn_not_modeled(self, except_for: Sequence[str] = ()) -> None:
        """Warn about `not_modeled` members other than `except_for`, since results are not comparable with others'."""
        if names := [name for name in self.not_modeled if name not in except_for]:
            ignored = ", ".join(map(shortened, names))
            message = f"{self.name}: not modeled: {ignored}; results are not comparable with the competition's"
            warnings.warn(message, stacklevel=3)

    def _check_goals(self, count: int) -> None:
        most = MAX_GOALS // self.team_size
        if not 1 <= count <= most:
            raise ValueError(f"goals_per_agent: expected 1 to {most} for {self.team_size} robots, got {count}")


def read_problem(path: str | Path) -> LorrProblem:
    """Read a problem's JSON file and the three files that it names, which must be in the JSON file's folder or below.

    If `teamSize` is smaller than the number of agents in the agents' file, the first ones are used.

    Raises:
        FileNotFoundError: A file does not exist.
        FormatError: A file is malformed, a cell is outside the map or an obstacle, or two robots have the same start.
    """
    text = read_text(path)
    if len(text) > MAX_PROBLEM_CHARACTERS:
        raise FormatError(path, f"expected a problem of at most {MAX_PROBLEM_CHARACTERS} characters")
    data = parse_object(text, path)
    size = whole_number(data, "teamSize", path, least=1)
    strategy = data.get("taskAssignmentStrategy", ENTRANT)
    if strategy not in STRATEGIES:
        raise FormatError(path, f"expected 'taskAssignmentStrategy' {', '.join(STRATEGIES)}, got {shortened(strategy)}")
    grid = read_map(_named_file(data, "mapFile", path))
    agent_file, task_file = _named_file(data, "agentFile", path), _named_file(data, "taskFile", path)
    starts, counts, first_line = _read_cells(agent_file, grid, errands=1)
    if size > len(counts):
        raise FormatError(path, f"expected a 'teamSize' of at most {len(counts)}, the agents in {agent_file}")
    _check_different(starts, first_line, agent_file)
    errands, counts, _ = _read_cells(task_file, grid, errands=MAX_ERRANDS_PER_TASK)
    delays = _delays(data, path)
    return LorrProblem(
        grid=grid,
        starts=frozen(starts[:size], np.int32),
        errands=frozen(errands, np.int32),
        offsets=frozen(np.concatenate([[0], np.cumsum(counts)]), np.int64),
        strategy=strategy,
        version=None if data.get("version") is None else text_member(data, "version", path),
        reveal=_reveal(data, path),
        delays=delays,
        name=Path(path).stem,
        not_modeled=tuple(
            key
            for key in data
            if key not in MODELED and NEUTRAL.get(key) != data[key] and not (key == DELAYS and delays is not None)
        ),
    )


def format_problem(problem: LorrProblem) -> dict[str, str]:
    """Return the texts of a problem's files by name, its JSON file first; they contain what this package supports."""
    names = {"mapFile": f"{problem.grid.name}.map", "agentFile": f"{problem.name}.agents"}
    names["taskFile"] = f"{problem.name}.tasks"
    members: JsonObject = {**names, "teamSize": problem.team_size}
    members |= {} if problem.reveal == 1 else {"numTasksReveal": problem.reveal}
    members |= {} if problem.delays is None else {DELAYS: _format_delays(problem.delays)}
    members |= {} if problem.strategy == ENTRANT else {"taskAssignmentStrategy": problem.strategy}
    members |= {} if problem.version is None else {"version": problem.version}
    cells = (problem.errands @ (problem.grid.shape[1], 1)).tolist()
    ends = problem.offsets.tolist()
    tasks = [",".join(map(str, cells[start:end])) for start, end in pairwise(ends)]
    starts = map(str, (problem.starts @ (problem.grid.shape[1], 1)).tolist())
    return {
        f"{problem.name}.json": json.dumps(members, indent=4) + "\n",
        names["mapFile"]: format_map(problem.grid),
        names["agentFile"]: "\n".join([str(problem.team_size), *starts]) + "\n",
        names["taskFile"]: "\n".join([str(problem.num_tasks), *tasks]) + "\n",
    }


def _delays(data: JsonObject, origin: str | Path) -> Delays | None:
    """Return the delays; None if there are none, or if they are distributed otherwise than those of `Delays`.

    The seed is that of the episode, and not that in the file.
    """
    given = data.get(DELAYS)
    if given is None:
        return None
    if not isinstance(given, dict):
        raise FormatError(origin, f"expected {DELAYS!r} to be an object, got {shortened(given)}")
    shape = given.get("gaussMeanRatio", 0.5), given.get("gaussStdRatio", NORMAL_DEVIATION)
    durations = given.get("durationModel", "uniform")
    if durations == "gaussian" and shape != (0.5, NORMAL_DEVIATION):
        return None
    fields: dict[str, Any] = {
        "probability": given.get("pDelay"),
        "duration": (given.get("minDelay"), given.get("maxDelay")),
        "events": given.get("eventModel", "bernoulli"),
        "durations": DURATIONS.get(durations, durations),
    }
    try:
        return Delays(**fields)
    except ValueError as error:
        raise FormatError(origin, f"{DELAYS!r}: {error}") from None


def _format_delays(delays: Delays) -> JsonObject:
    smallest, largest = delays.duration
    model = {name: word for word, name in DURATIONS.items()}[delays.durations]
    limits = {"pDelay": delays.probability, "minDelay": smallest, "maxDelay": largest}
    return {**limits, "eventModel": delays.events, "durationModel": model}


def _reveal(data: JsonObject, origin: str | Path) -> float:
    """Return the number of revealed tasks per robot."""
    reveal = data.get("numTasksReveal", 1)
    if isinstance(reveal, bool) or not isinstance(reveal, int | float) or not 0 < reveal <= MAX_REVEAL:
        raise FormatError(origin, f"expected 'numTasksReveal' above 0, up to {MAX_REVEAL}, got {shortened(reveal)}")
    return float(reveal)


def _named_file(data: JsonObject, name: str, origin: str | Path) -> Path:
    """Return the file that the JSON file names, which must be inside the JSON file's folder."""
    return named_file(text_member(data, name, origin), name, Path(origin).parent, origin)


def _read_cells(path: Path, grid: Grid, errands: int) -> tuple[Ints, Ints, int]:
    """Read a file of up to `errands` cells per line; return cells (E, 2), counts per line (K,) and first line."""
    lines = _content(path)
    number, line = next(lines, (1, ""))
    if not re.fullmatch(_NUMBER, line, re.ASCII) or int(line) < 1:
        raise FormatError(path, f"expected the number of lines that follow, 1 or more, got {shortened(line)}", number)
    expected, first_line = int(line), number + 1
    pattern = re.compile(rf"{_NUMBER}(,{_NUMBER}){{0,{errands - 1}}}", re.ASCII)
    cells, counts = array("q"), array("q")
    for number, line in lines:
        if len(counts) == expected:
            if line.strip():
                raise FormatError(path, f"expected the end of the file after {expected} lines", number)
        elif not pattern.fullmatch(line):
            what = "a cell's number" if errands == 1 else f"1 to {errands} cells' numbers between commas"
            raise FormatError(path, f"expected {what}, got {shortened(line)}", number)
        else:
            numbers = line.split(",")
            cells.extend(map(int, numbers))
            counts.append(len(numbers))
    if len(counts) < expected:
        raise FormatError(path, f"expected {expected} lines, got {len(counts)}", number)
    places = np.stack(np.divmod(np.array(cells), grid.shape[1]), axis=1)
    _check_free(places, np.array(counts), grid, path, first_line)
    return places, np.array(counts), first_line


def _content(path: Path) -> Iterator[tuple[int, str]]:
    """Yield the numbered lines, without the comments at the start of the file."""
    lines = enumerate((line.rstrip("\r\n") for line in io.StringIO(read_text(path))), 1)
    in_comments = True
    for number, line in lines:
        in_comments = in_comments and line.startswith("#")
        if not in_comments:
            yield number, line


def _check_free(places: Ints, counts: Ints, grid: Grid, path: Path, first_line: int) -> None:
    """Raise `FormatError` for the first of `places` (E, 2), with `counts` (K,) per line, that is not a free cell."""
    height, width = grid.shape
    inside = places[:, 0] < height
    usable = inside.copy()
    usable[inside] = grid.free[places[inside, 0], places[inside, 1]]
    if not usable.all():
        worst = int(np.argmin(usable))
        row, col = places[worst].tolist()
        problem = "an obstacle" if inside[worst] else "outside"
        message = f"expected a free cell of map {grid.name!r} ({height} x {width}), got {row * width + col}, {problem}"
        raise FormatError(path, message, first_line + int(np.searchsorted(np.cumsum(counts), worst, side="right")))


def _check_different(starts: Ints, first_line: int, path: Path) -> None:
    """Raise `FormatError` for the first line whose cell is in an earlier line, too."""
    _, first = np.unique(starts, axis=0, return_index=True)
    if len(first) < len(starts):
        agent = int(np.setdiff1d(np.arange(len(starts)), first)[0])
        row, col = starts[agent].tolist()
        message = f"expected different starts, got [row {row}, col {col}] again"
        raise FormatError(path, message, first_line + agent)
