"""The results of an evaluation, which are written to a CSV file as it runs, so that it can be resumed."""

from __future__ import annotations

import codecs
import csv
import io
import math
import os
import re
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from reprlib import repr as shortened

from mapf_pz._internal.atomic import naming, write_whole
from mapf_pz._internal.printable import from_cell, to_cell
from mapf_pz._internal.text import read_bytes
from mapf_pz.errors import FormatError
from mapf_pz.evaluation.identity import IDENTITIES_FILE, Identities
from mapf_pz.evaluation.task import EvaluationTask, task_label
from mapf_pz.simulator.metrics import DELAY_METRICS, WEIGHTED_METRICS, metric_names

METRICS = (
    "CSR",
    "ISR",
    "SoC",
    "SoC_ratio",
    *WEIGHTED_METRICS,
    *DELAY_METRICS,
    "makespan",
    "avg_throughput",
    "exhausted_agents",
    "best_ratio",
    "ep_length",
    "collisions",
    "runtime",
    "step_ms",
    "agent_us",
)
"""All metrics, in the order of the file's columns. An episode's depend on its mode, edge weights and delays."""
COLUMNS = ("policy", "task", "num_agents", "episode", "instance", "seed", "suite", *METRICS, "note")
_UNDELAYED = tuple(name for name in COLUMNS if name not in DELAY_METRICS)
_UNWEIGHTED = tuple(name for name in _UNDELAYED if name not in WEIGHTED_METRICS)
"""The columns of earlier versions, whose episodes have no delays and no weighted costs."""
_OLD_START = b"policy,task,num_agents,episode,instance,seed,CSR,"
"""Start of the files of earlier versions without suites."""
_OUTDATED = "results of an earlier version, without suites: evaluate again in another folder, or with overwrite"
EPISODES_FILE = "episodes.csv"
NOTHING = Identities()
"""No policies and no tasks, as for reading episodes."""
MAX_BYTES = 2**30
"""Maximum size of the file of episodes (about ten million episodes)."""
_SHARES = ("CSR", "ISR", "collisions", DELAY_METRICS[0])
"""The metrics that are at most 1."""
_OPTIONAL = {*WEIGHTED_METRICS, *DELAY_METRICS, "best_ratio", "runtime", "step_ms", "agent_us"}
_ONE_SHOT, _LIFELONG = ((*metric_names(mode), "collisions") for mode in ("nothing", "restart"))
"""The other metrics of an episode, all of which it has."""
_WHOLE = re.compile(r"[0-9]{1,18}")
_NUMBER = re.compile(r"[0-9]+(\.[0-9]+)?(e[+-]?[0-9]+)?")


@dataclass(frozen=True)
class Episode:
    """The result of an episode."""

    policy: str
    """The policy's name."""
    task: str
    """The task's name."""
    num_agents: int
    """Number of agents."""
    number: int
    """Number of the episode in its task, from 0."""
    metrics: dict[str, float] = field(default_factory=dict)
    """Metrics by name, out of `METRICS`."""
    instance: str = ""
    """Name of the instance; empty if the environment generated it."""
    seed: int = 0
    """Random seed of the episode."""
    suite: str = ""
    """Name, version and digest of the task's suite, `EvaluationTask.suite`; empty if there is none."""
    note: str = ""
    """Why an external planner's plan was not executed, such as the first violation of the rules; otherwise empty."""

    @property
    def key(self) -> tuple[str, str, int, int]:
        """Key that is unique within an evaluation."""
        return self.policy, self.task, self.num_agents, self.number

    @property
    def task_label(self) -> str:
        """Label of the task, `EvaluationTask.label`."""
        return task_label(self.task, self.num_agents)


class Results:
    """Episodes in memory and, with a folder, in its file `episodes.csv`, to which finished episodes are appended."""

    def __init__(
        self,
        folder: Path | None = None,
        identities: Identities = NOTHING,
        overwrite: bool = False,
        tasks: Sequence[EvaluationTask] = (),
    ) -> None:
        """Start, or resume if the folder contains episodes, which no other process may write to.

        An incomplete last line, from a killed evaluation, is removed from the file, and columns that a file of an
        earlier version lacks are added.

        Args:
            folder: the folder; None: episodes are only in memory.
            identities: the policies and tasks that are to be evaluated.
            overwrite: delete the episodes of those policies and tasks if they have another identity.
            tasks: the tasks, whose episodes must have their instances and seeds.

        Raises:
            ValueError: there are such episodes, and `overwrite` is False.
            FormatError: a file of the folder is malformed.
        """
        self.episodes: list[Episode] = []
        self._file = None if folder is None else folder / EPISODES_FILE
        if folder is None or self._file is None:
            return
        folder.mkdir(parents=True, exist_ok=True)
        recorded = Identities.read(folder)
        found, size = {}, 0
        if self._file.exists() and not (overwrite and _is_outdated(self._file)):
            found, size = _read(self._file)
        changes = recorded.changes(
            identities, (one.policy for one in found.values()), (one.task_label for one in found.values())
        )
        if changes.first is not None and not overwrite:
            raise ValueError(f"{folder}: {changes.first}; expected another folder, or overwrite")
        kept = {
            line: one
            for line, one in found.items()
            if one.policy not in changes.policies and one.task_label not in changes.tasks
        }
        _check_tasks(kept, tasks, self._file)
        self.episodes = list(kept.values())
        if not size or len(kept) < len(found):
            _write_all(self._file, self.episodes)
        elif size < self._file.stat().st_size:
            os.truncate(self._file, size)
        if recorded.updated(identities) != recorded:
            recorded.updated(identities).write(folder)

    def add(self, episode: Episode) -> None:
        """Add an episode, and append it to the file."""
        self.episodes.append(episode)
        if self._file is not None:
            with naming(self._file), self._file.open("a", newline="", encoding="utf-8") as out:
                csv.writer(out, lineterminator="\n").writerow(_row(episode))

    def done(self) -> set[tuple[str, str, int, int]]:
        """Return the keys of all episodes."""
        return {episode.key for episode in self.episodes}


def read_episodes(folder: Path) -> list[Episode]:
    """Return the episodes of an evaluation, which may still run. Nothing is written.

    Raises:
        FileNotFoundError: the folder has no evaluation.
        FormatError: its file is malformed.
    """
    file = folder / EPISODES_FILE
    if not file.is_file():
        raise FileNotFoundError(f"{folder}: expected the folder of an evaluation, with a file {EPISODES_FILE}")
    return list(_read(file)[0].values())


def discard(folder: Path) -> None:
    """Delete the files of an evaluation from a folder."""
    for name in (EPISODES_FILE, IDENTITIES_FILE):
        (folder / name).unlink(missing_ok=True)


def _row(episode: Episode) -> list[object]:
    policy, suite, task, instance = map(to_cell, (episode.policy, episode.suite, episode.task, episode.instance))
    metrics = (episode.metrics.get(name, "") for name in METRICS)
    numbers = episode.num_agents, episode.number
    return [policy, task, *numbers, instance, episode.seed, suite, *metrics, to_cell(episode.note)]


def _write_all(file: Path, episodes: Iterable[Episode]) -> None:
    text = io.StringIO(newline="")
    csv.writer(text, lineterminator="\n").writerows([COLUMNS, *map(_row, episodes)])
    write_whole(file, text.getvalue().encode())


def _read(file: Path) -> tuple[dict[int, Episode], int]:
    """Return the episodes by their lines, and the size of these lines in bytes, 0 if they have not all `COLUMNS`.

    An incomplete last line is ignored: a killed evaluation has left it, or a running one is writing it.
    """
    content = read_bytes(file, MAX_BYTES)
    start, size = content.removeprefix(codecs.BOM_UTF8), content.rfind(b"\n") + 1
    if start.startswith(_OLD_START):
        raise FormatError(file, _OUTDATED, 1)
    columns = next((names for names in (COLUMNS, _UNDELAYED, _UNWEIGHTED) if _begins_with(start, names)), None)
    if columns is None:
        raise FormatError(file, f"expected the columns {', '.join(COLUMNS)}", 1)
    try:
        text = content[:size].decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise FormatError(file, "expected UTF-8 text", content.count(b"\n", 0, error.start) + 1) from None
    rows = csv.reader(io.StringIO(text, newline=""), strict=True)
    next(rows, None)
    episodes: dict[int, Episode] = {}
    lines: dict[tuple[str, str, int, int], int] = {}
    try:
        for row in rows:
            episode = _episode(row, columns, rows.line_num, file)
            first = lines.setdefault(episode.key, rows.line_num)
            if first != rows.line_num:
                raise FormatError(file, f"the same policy, task and episode as in line {first}", rows.line_num)
            episodes[rows.line_num] = episode
    except csv.Error as error:
        raise FormatError(file, f"expected CSV: {error}", rows.line_num) from None
    return episodes, size if columns is COLUMNS else 0


def _begins_with(content: bytes, columns: Sequence[str]) -> bool:
    """Return whether a file begins with the header of these columns, or is incomplete before its end."""
    header = f"{','.join(columns)}\n".encode()
    return content.startswith(header) or header.startswith(content)


def _is_outdated(file: Path) -> bool:
    """Return whether a file is of an earlier version without suites."""
    if not file.is_file():
        return False
    with file.open("rb") as content:
        return content.read(len(_OLD_START)) == _OLD_START


def _check_tasks(episodes: Mapping[int, Episode], tasks: Iterable[EvaluationTask], file: Path) -> None:
    """Raise `FormatError` for an episode, by its line, that has another instance, seed or suite than its task."""
    by_label = {task.label: task for task in tasks}
    for line, episode in episodes.items():
        task = by_label.get(episode.task_label)
        if task is not None:
            number = episode.number
            expected = {"instance": task.instance_name(number), "seed": task.seed + number, "suite": task.suite}
            for name, value in expected.items():
                got = getattr(episode, name)
                if got != value:
                    raise FormatError(file, f"{name}={shortened(got)}: expected {value!r}, that of the task", line)


def _episode(row: list[str], columns: Sequence[str], line: int, file: Path) -> Episode:
    """Return the episode of a row with a value for each of the columns; raises `FormatError`."""
    if len(row) != len(columns):
        raise FormatError(file, f"expected an episode of {len(columns)} values, got {len(row)}", line)
    cells = dict(zip(columns, map(from_cell, row), strict=True))
    try:
        num_agents, number, seed = (_whole(name, cells[name]) for name in ("num_agents", "episode", "seed"))
        metrics = {name: _metric(name, cells[name]) for name in METRICS if cells.get(name)}
    except ValueError as error:
        raise FormatError(file, str(error), line) from None
    expected = _LIFELONG if "avg_throughput" in metrics else _ONE_SHOT
    if metrics.keys() - _OPTIONAL != set(expected):
        raise FormatError(file, f"expected the metrics {', '.join(expected)}, got {', '.join(metrics) or 'none'}", line)
    instance, suite, note = (cells[name] for name in ("instance", "suite", "note"))
    return Episode(cells["policy"], cells["task"], num_agents, number, metrics, instance, seed, suite, note)


def _whole(name: str, text: str) -> int:
    """Return the whole number in a column; raises `ValueError` if there is something else."""
    least = 1 if name == "num_agents" else 0
    if not _WHOLE.fullmatch(text) or int(text) < least:
        raise ValueError(f"{name}={shortened(text)}: expected a whole number, {least} or more")
    return int(text)


def _metric(name: str, text: str) -> float:
    """Return the metric in a column; raises `ValueError` if there is something else."""
    if name in WEIGHTED_METRICS and text == "inf":
        return math.inf
    most = 1 if name in _SHARES else sys.float_info.max
    if not _NUMBER.fullmatch(text) or float(text) > most:
        expected = "a number from 0 to 1" if name in _SHARES else "a finite number, 0 or more"
        raise ValueError(f"{name}={shortened(text)}: expected {expected}")
    return float(text)
