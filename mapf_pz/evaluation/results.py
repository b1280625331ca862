"""The results of an evaluation, which are written to a CSV file as it runs, so that it can be resumed."""

from __future__ import annotations

import csv
import io
import json
import os
from collections.abc import Iterable
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from mapf_pz.config import DEFAULT_MAP
from mapf_pz.errors import FormatError
from mapf_pz.evaluation.task import EvaluationTask
from mapf_pz.guidance.library import is_guidance_file
from mapf_pz.instances import load_map
from mapf_pz.io.atomic import naming, write_whole
from mapf_pz.io.printable import from_cell, to_cell
from mapf_pz.io.text import read_bytes, read_text

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
COLUMNS = ("policy", "task", "num_agents", "episode", "instance", "seed", *METRICS)
EPISODES_FILE, TASKS_FILE = "episodes.csv", "tasks.json"
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

    @property
    def key(self) -> tuple[str, str, int, int]:
        """Key that is unique within an evaluation."""
        return self.policy, self.task, self.num_agents, self.number


class Results:
    """Episodes in memory and, with a folder, in its file `episodes.csv`, to which finished episodes are appended."""

    def __init__(self, tasks: Iterable[EvaluationTask], folder: Path | None = None) -> None:
        """Start, or resume if the folder contains episodes of the same tasks.

        Raises `ValueError` if it contains episodes of other tasks, and `FormatError` if its file is malformed.
        """
        self.episodes: list[Episode] = []
        self._file = None if folder is None else folder / EPISODES_FILE
        if folder is None or self._file is None:
            return
        folder.mkdir(parents=True, exist_ok=True)
        description = json.dumps([_description(task) for task in tasks], indent=1)
        file = folder / TASKS_FILE
        if not file.exists():
            write_whole(file, description.encode())
        elif file.read_bytes() != description.encode():
            raise ValueError(f"{folder}: contains an evaluation of other tasks; expected another folder")
        if self._file.exists():
            self.episodes = _read(self._file)
        if not self._file.exists() or not self._file.stat().st_size:
            _write_rows(self._file, "w", [COLUMNS])

    def add(self, episode: Episode) -> None:
        """Add an episode, and append it to the file."""
        self.episodes.append(episode)
        if self._file is not None:
            _write_rows(self._file, "a", [_row(episode)])

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
    for name in (EPISODES_FILE, TASKS_FILE):
        (folder / name).unlink(missing_ok=True)


def discard_policies(folder: Path, policies: Iterable[str]) -> None:
    """Delete the episodes of some policies from the file of an evaluation."""
    file, dropped = folder / EPISODES_FILE, set(policies)
    rows = [_row(episode) for episode in _read(file) if episode.policy not in dropped]
    text = io.StringIO(newline="")
    csv.writer(text, lineterminator="\n").writerows([COLUMNS, *rows])
    write_whole(file, text.getvalue().encode())


def _row(episode: Episode) -> list[object]:
    policy, task, instance = map(to_cell, (episode.policy, episode.task, episode.instance))
    metrics = (episode.metrics.get(name, "") for name in METRICS)
    return [policy, task, episode.num_agents, episode.number, instance, episode.seed, *metrics]


def _description(task: EvaluationTask) -> dict[str, Any]:
    """Return the settings that must be equal for episodes to be comparable; the number of episodes may differ."""
    excluded = ("map", "source", "distance_bytes")  # in the digest; the last one does not affect episodes
    keywords = {name: repr(value) for name, value in sorted(task.keywords.items()) if name not in excluded}
    weights = task.keywords.get("edge_weights")
    if is_guidance_file(weights):
        keywords["edge_weights"] = sha256(read_bytes(weights)).hexdigest()
    return {"task": task.label, "seed": task.seed, "keywords": keywords, "instances": _digest(task)}


def _digest(task: EvaluationTask) -> str:
    """Return a hash of the instances or, if instances are generated, of the map or of the first instance."""
    source = task.keywords.get("source")
    instances = task.instances or (() if source is None else (source.sample(np.random.default_rng(task.seed)),))
    arrays = [load_map(task.keywords.get("map", DEFAULT_MAP)).free] if not instances else []
    for instance in instances:
        arrays += [instance.grid.free, instance.scenario.starts, instance.scenario.goals]
        arrays += [] if instance.headings is None else [instance.headings]
    digest = sha256()
    for array in arrays:
        digest.update(str(array.shape).encode() + array.tobytes())
    return digest.hexdigest()


def _write_rows(file: Path, mode: str, rows: Iterable[Iterable[object]]) -> None:
    with naming(file), file.open(mode, newline="", encoding="utf-8") as out:
        csv.writer(out, lineterminator="\n").writerows(rows)


def _read(file: Path) -> list[Episode]:
    """Read the episodes. An incomplete last line, from a killed evaluation, is removed from the file."""
    header = ",".join(COLUMNS) + "\n"
    if file.is_file():
        _remove_partial_line(file, header.encode())
    text = read_text(file, MAX_BYTES)
    if text and not text.startswith(header):
        raise FormatError(file, f"expected the columns {', '.join(COLUMNS)}", 1)
    rows = csv.reader(io.StringIO(text, newline=""), strict=True)
    next(rows, None)
    try:
        return [_episode(row, rows.line_num, file) for row in rows]
    except csv.Error as error:
        raise FormatError(file, f"expected CSV: {error}", rows.line_num) from None


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
        policy, task_name, num_agents, number, instance, seed, *values = map(from_cell, row)
        named = zip(METRICS, values, strict=True)
        metrics = {name: float(value) for name, value in named if value}
        return Episode(policy, task_name, int(num_agents), int(number), metrics, instance, int(seed))
    except ValueError as error:
        raise FormatError(file, f"expected an episode: {error}", line) from None
