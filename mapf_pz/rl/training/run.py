"""The folder of a training run: configuration, progress in several formats, checkpoints and policy."""

from __future__ import annotations

import math
import shutil
from pathlib import Path

from torch import nn

from mapf_pz.errors import FormatError
from mapf_pz.rl.algorithms.learner import Learner
from mapf_pz.rl.algorithms.state_buffer import DATA, step_files
from mapf_pz.rl.config import TrainConfig
from mapf_pz.rl.config_file import CONFIG_FILES, config_values, save_config
from mapf_pz.rl.demonstrations.folder import dataset_files
from mapf_pz.rl.inputs import sources_digest
from mapf_pz.rl.policies.folder import WEIGHTS, policy_folder
from mapf_pz.rl.policies.load import save_weights
from mapf_pz.rl.progress import PROGRESS, Row, append_progress, read_progress, write_progress
from mapf_pz.rl.training.checkpoint import FOLDER, Checkpoints, Position, read_position, restore
from mapf_pz.rl.training.curves import Run, draw_curves
from mapf_pz.rl.training.loggers import LOGGER_FOLDERS, ProgressLogger, make_loggers

CURVE = "learning_curve.png"
CURVES = ("CSR", "ISR", "throughput", "agreement", "return")
"""Columns of the progress file that are drawn if there are any."""
RUN_FILES = (*CONFIG_FILES, WEIGHTS, PROGRESS, CURVE, FOLDER, DATA, *LOGGER_FOLDERS)
"""All files and folders that a run writes into its folder."""
RECENT_EPISODES = 100
"""Number of latest training episodes whose mean CSR, or throughput, determines the best checkpoint. Without training
episodes (`bc`), the latest validation determines it."""


class RunFolder:
    """Writes the files of a training run."""

    def __init__(self, path: Path) -> None:
        """Refer to the folder; nothing is written before `prepare`."""
        self.path = path
        self.checkpoints = Checkpoints(path)
        self._rows: list[Row] = []
        self._inputs = ""
        self._saved_steps = 0  # agent steps at the latest checkpoint
        self._loggers: list[ProgressLogger] = []

    def check_unused(self) -> None:
        """Raise `FileExistsError` if the folder holds a run."""
        if any((self.path / name).exists() for name in RUN_FILES):
            raise FileExistsError(
                f"output {str(self.path)!r} holds a run: continue it with `mapf-pz train resume {self.path}`, "
                "choose another output, or replace it with --overwrite (overwrite=True)"
            )

    def restore(self, checkpoint: Path, learner: Learner) -> int:
        """Restore the learner and the progress from a checkpoint, and return its number of updates.

        Only reads files. Raises `FormatError` if the checkpoint or the progress file is damaged, or if they belong to
        different runs.
        """
        restore(checkpoint, learner)
        position = read_position(checkpoint)
        self._rows = read_progress(self.path, position.updates)
        last = self._rows[-1]["agent_steps"] if self._rows else 0
        if len(self._rows) < position.updates or last != position.agent_steps:
            expected = f"{position.updates} rows, the last of agent step {position.agent_steps}"
            raise FormatError(self.path / PROGRESS, f"expected {expected}")
        self._saved_steps = position.agent_steps
        if learner.data is not None:
            for file in step_files(self.path, last=position.agent_steps):
                learner.data.load(file)
        return position.updates

    def prepare(self, config: TrainConfig) -> None:
        """Prepare the folder: remove files that are newer than the restored checkpoint, or all if none was restored."""
        self._inputs = inputs_digest(config)
        self.path.mkdir(parents=True, exist_ok=True)
        self._loggers = make_loggers(self.path, config, self._rows)  # first: their services may be out of reach
        if self._rows:
            self.checkpoints.sweep()
            write_progress(self.path, self._rows)
            for file in step_files(self.path, first=self._saved_steps + 1):  # of steps that are collected again
                file.unlink()
        else:
            self.checkpoints.clear()
            shutil.rmtree(self.path / DATA, ignore_errors=True)
            for name in (PROGRESS, CURVE, WEIGHTS):
                (self.path / name).unlink(missing_ok=True)
        save_config(self.path, config)

    @property
    def seconds(self) -> float:
        """Duration of the run in seconds, up to the latest row."""
        return self._rows[-1]["seconds"] if self._rows else 0.0

    def log(self, row: Row) -> None:
        """Append one row to the progress file; all rows have the same keys."""
        append_progress(self.path, row, is_first=not self._rows)
        self._rows.append(row)
        for logger in self._loggers:
            logger.log(row)

    def save(self, learner: Learner, interval: int = 1) -> None:
        """Write a checkpoint if the latest is at least `interval` agent steps old."""
        if not self._rows or self._rows[-1]["agent_steps"] < self._saved_steps + interval:
            return
        score = self._recent_score() if "episodes" in self._rows[-1] else self._validation_score()
        position = Position(len(self._rows), int(self._rows[-1]["agent_steps"]), score, self._inputs)
        if learner.data is not None:
            (self.path / DATA).mkdir(exist_ok=True)
            learner.data.save(self.path / DATA / f"{position.agent_steps:015d}.npz")
        self.checkpoints.save(learner, position)
        self._saved_steps = position.agent_steps

    def finish(self, network: nn.Module, config: TrainConfig) -> None:
        """Write the policy and the learning curve."""
        save_weights(self.path, network)
        for logger in self._loggers:
            logger.close()
        if self._rows:
            draw_curves([Run(self.path.name, config_values(config), self._rows)], CURVES, self.path / CURVE)

    def _recent_score(self) -> float:
        """Return the mean CSR or throughput over the rows with the latest episodes, or 0 if no episode has ended."""
        episodes = total = 0.0
        for row in reversed(self._rows):
            if row.get("episodes"):
                score = row["throughput"] if "throughput" in row else row["CSR"]
                episodes, total = episodes + row["episodes"], total + score * row["episodes"]
            if episodes >= RECENT_EPISODES:
                break
        return total / episodes if episodes else 0.0

    def _validation_score(self) -> float:
        """Return the CSR or throughput of the latest validation, or 0 if there was none."""
        for row in reversed(self._rows):
            score = row.get("validation_throughput", row.get("validation_CSR", math.nan))
            if not math.isnan(score):
                return score
        return 0.0


def inputs_digest(config: TrainConfig) -> str:
    """Return the digest of a run's maps and scenarios, the data of `dataset`, and the weights of its initial policy."""
    initial = None if config.initial_policy is None else policy_folder(config.initial_policy) / WEIGHTS
    files = {file.name: file for file in _dataset_files(config)}
    return sources_digest([config.task.source], files, initial)


def _dataset_files(config: TrainConfig) -> list[Path]:
    """Return the files of the data that a run learns from, other than its own."""
    files_of = {"bc": dataset_files, "dagger": step_files}.get(config.algorithm)
    dataset = config.imitation.dataset
    return [] if dataset is None or files_of is None else files_of(Path(dataset))
