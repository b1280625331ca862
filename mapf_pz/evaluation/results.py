"""The results of an evaluation, which are written to a CSV file as it runs, so that it can be resumed."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

from mapf_pz._internal.atomic import naming, write_whole
from mapf_pz._internal.printable import from_cell, to_cell
from mapf_pz._internal.text import read_text
from mapf_pz.errors import FormatError
from mapf_pz.evaluation.identity import IDENTITIES_FILE, Identities
from mapf_pz.evaluation.task import task_label

METRICS = (
    "CSR",
    "ISR",
    "SoC",
    "SoC_ratio",
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
"""All metrics, in the order of the file's columns. Which of them an episode has depends on its mode."""
COLUMNS = ("policy", "task", "num_agents", "episode", "instance", "seed", "suite", *METRICS, "note")
_OLD_START = "policy,task,num_agents,episode,instance,seed,CSR,"
"""Start of the files of earlier versions."""
_OUTDATED = "results of an earlier version, without suites: evaluate again in another folder, or with overwrite"
EPISODES_FILE = "episodes.csv"
NOTHING = Identities()
"""No policies and no tasks, as for reading episodes."""
MAX_BYTES, MAX_ROW_BYTES = 2**30, 2**20
"""Maximum size of the file of episodes (about ten million episodes), and of a row in it."""


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

    def __init__(self, folder: Path | None = None, identities: Identities = NOTHING, overwrite: bool = False) -> None:
        """Start, or resume if the folder contains episodes.

        Args:
            folder: the folder; None: episodes are only in memory.
            identities: the policies and tasks that are to be evaluated.
            overwrite: delete the episodes of those policies and tasks if they have another identity.

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
        outdated = overwrite and _is_outdated(self._file)
        if self._file.exists() and not outdated:
            self.episodes = _read(self._file)
        changes = recorded.changes(
            identities, (episode.policy for episode in self.episodes), (episode.task_label for episode in self.episodes)
        )
        if changes.first is not None and not overwrite:
            raise ValueError(f"{folder}: {changes.first}; expected another folder, or overwrite")
        kept = [e for e in self.episodes if e.policy not in changes.policies and e.task_label not in changes.tasks]
        if outdated or len(kept) < len(self.episodes) or not self._file.exists() or not self._file.stat().st_size:
            self.episodes = kept
            _write_all(self._file, kept)
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
    """Return the episodes of an evaluation.

    Raises:
        FileNotFoundError: the folder has no evaluation.
        FormatError: its file is malformed.
    """
    file = folder / EPISODES_FILE
    if not file.is_file():
        raise FileNotFoundError(f"{folder}: expected the folder of an evaluation, with a file {EPISODES_FILE}")
    return _read(file)


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


def _read(file: Path) -> list[Episode]:
    """Read the episodes. An incomplete last line, from a killed evaluation, is removed from the file."""
    header = ",".join(COLUMNS) + "\n"
    if file.is_file():
        _remove_partial_line(file, header.encode())
    text = read_text(file, MAX_BYTES)
    if text.startswith(_OLD_START):
        raise FormatError(file, _OUTDATED, 1)
    if text and not text.startswith(header):
        raise FormatError(file, f"expected the columns {', '.join(COLUMNS)}", 1)
    rows = csv.reader(io.StringIO(text, newline=""), strict=True)
    next(rows, None)
    try:
        return [_episode(row, rows.line_num, file) for row in rows]
    except csv.Error as error:
        raise FormatError(file, f"expected CSV: {error}", rows.line_num) from None


def _is_outdated(file: Path) -> bool:
    """Return whether a file is of an earlier version."""
    if not file.is_file():
        return False
    with file.open("rb") as content:
        return content.read(len(_OLD_START)) == _OLD_START.encode()


def _remove_partial_line(file: Path, header: bytes) -> None:
    """Remove an incomplete last line, which may end within a character, if the file has the expected header."""
    with file.open("r+b") as out:
        start = out.read(len(header))
        size = out.seek(0, os.SEEK_END)
        first = out.seek(max(0, size - MAX_ROW_BYTES))
        end = out.read()
        if header.startswith(start) and not end.endswith(b"\n") and (b"\n" in end or not first):
            out.truncate(first + end.rfind(b"\n") + 1)


def _episode(row: list[str], line: int, file: Path) -> Episode:
    if len(row) != len(COLUMNS):
        raise FormatError(file, f"expected an episode of {len(COLUMNS)} values, got {len(row)}", line)
    try:
        policy, task_name, num_agents, number, instance, seed, suite, *values, note = map(from_cell, row)
        named = zip(METRICS, values, strict=True)
        metrics = {name: float(value) for name, value in named if value}
        return Episode(policy, task_name, int(num_agents), int(number), metrics, instance, int(seed), suite, note)
    except ValueError as error:
        raise FormatError(file, f"expected an episode: {error}", line) from None
