"""The episodes of an evaluation, kept in a CSV file while it goes on, so that it can be resumed."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mapf_pz.evaluate.trial import Trial
from mapf_pz.types import FormatError

METRICS = (
    "CSR",
    "ISR",
    "SoC",
    "SoC_ratio",
    "makespan",
    "avg_throughput",
    "best_ratio",
    "ep_length",
    "collisions",
    "runtime",
    "step_ms",
    "agent_us",
)
"""All metrics, in the order of the file's columns; an episode has those that its mode knows."""
COLUMNS = ("policy", "about", "num_agents", "episode", *METRICS)
EPISODES_FILE, TRIALS_FILE = "episodes.csv", "trials.json"


@dataclass(frozen=True)
class Episode:
    """What came of an episode."""

    policy: str
    """The policy's name."""
    about: str
    """The trial's `family`."""
    num_agents: int
    """N."""
    number: int
    """Of the episode in its trial."""
    metrics: dict[str, float] = field(default_factory=dict)
    """By name, out of `METRICS`."""

    @property
    def key(self) -> tuple[str, str, int, int]:
        """What tells it from all others of an evaluation."""
        return self.policy, self.about, self.num_agents, self.number


class Results:
    """Episodes in memory and, with a folder, in its file `episodes.csv`, to which each is added when it is done."""

    def __init__(self, trials: Iterable[Trial], folder: Path | None = None) -> None:
        """Begin, or go on where the folder has episodes of the same trials.

        Raises `ValueError` where it has those of others, `FormatError` where its file is not one of ours.
        """
        self.episodes: list[Episode] = []
        self._file = None if folder is None else folder / EPISODES_FILE
        if folder is None or self._file is None:
            return
        folder.mkdir(parents=True, exist_ok=True)
        told = json.dumps([_description(trial) for trial in trials], indent=1)
        before = folder / TRIALS_FILE
        if before.exists() and before.read_text("utf-8") != told:
            raise ValueError(f"{folder}: holds an evaluation of other trials; expected another folder")
        before.write_text(told, "utf-8")
        if self._file.exists():
            self.episodes = _read(self._file)
        else:
            _write_rows(self._file, "w", [COLUMNS])

    def add(self, episode: Episode) -> None:
        """Add an episode, and write it."""
        self.episodes.append(episode)
        if self._file is not None:
            values = [episode.metrics.get(name, "") for name in METRICS]
            _write_rows(self._file, "a", [[*episode.key, *values]])

    def done(self) -> set[tuple[str, str, int, int]]:
        """Return the keys of all episodes."""
        return {episode.key for episode in self.episodes}


def _description(trial: Trial) -> dict[str, Any]:
    """Return what must be the same for episodes to be comparable; the number of episodes need not be."""
    keywords = {name: repr(value) for name, value in sorted(trial.keywords.items()) if name not in ("map", "source")}
    return {"trial": trial.name, "seed": trial.seed, "instances": len(trial.instances), "keywords": keywords}


def _write_rows(file: Path, mode: str, rows: Iterable[Iterable[object]]) -> None:
    with file.open(mode, newline="", encoding="utf-8") as out:
        csv.writer(out, lineterminator="\n").writerows(rows)


def _read(file: Path) -> list[Episode]:
    """Read the episodes; a last line that was cut off when the evaluation was killed is taken off the file."""
    text = file.read_text("utf-8")
    whole = text[: text.rfind("\n") + 1]
    if whole != text:
        file.write_text(whole, "utf-8")
    rows = csv.reader(whole.splitlines())
    if tuple(next(rows, ())) != COLUMNS:
        raise FormatError(file, f"expected the columns {', '.join(COLUMNS)}", 1)
    return [_episode(row, line, file) for line, row in enumerate(rows, 2)]


def _episode(row: list[str], line: int, file: Path) -> Episode:
    try:
        policy, about, num_agents, number, *values = row
        told = zip(METRICS, values, strict=True)
        metrics = {name: float(value) for name, value in told if value}
        return Episode(policy, about, int(num_agents), int(number), metrics)
    except ValueError as error:
        raise FormatError(file, f"expected an episode: {error}", line) from None
