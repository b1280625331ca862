"""The folder of a training run: configuration, progress in several formats, checkpoints and policy."""

from __future__ import annotations

import csv
import math
import shutil
from itertools import islice
from pathlib import Path

from torch import nn
from torchrl.record.loggers.tensorboard import TensorboardLogger

from mapf_pz.errors import FormatError
from mapf_pz.io.atomic import replacing, write_whole
from mapf_pz.rl.checkpoint import FOLDER, Checkpoints, Position, read_position, restore
from mapf_pz.rl.config import TrainConfig
from mapf_pz.rl.config_file import CONFIG_FILES, save_config
from mapf_pz.rl.learner import Learner
from mapf_pz.rl.policy import WEIGHTS, save_weights

PROGRESS, CURVE, TENSORBOARD = "progress.csv", "learning_curve.png", "tensorboard"
RUN_FILES = (*CONFIG_FILES, WEIGHTS, PROGRESS, CURVE, FOLDER, TENSORBOARD)
"""All files and folders that a run writes into its folder."""
RECENT_EPISODES = 100
"""Number of latest training episodes whose mean CSR, or throughput, determines the best checkpoint. Without training
episodes (`bc`), the latest validation determines it."""
CURVES = {
    "CSR": "all agents at their goals (CSR)",
    "ISR": "agents at their goals (ISR)",
    "throughput": "goals per step (throughput)",
    "agreement": "actions of the planner (agreement)",
}
"""Columns of the progress file that are plotted as learning curves if present, and their labels."""


class RunFolder:
    """Writes the files of a training run."""

    def __init__(self, path: Path) -> None:
        """Refer to the folder; nothing is written before `prepare`."""
        self.path = path
        self.checkpoints = Checkpoints(path)
        self._rows: list[dict[str, float]] = []
        self._saved_steps = 0  # agent steps at the latest checkpoint
        self._tensorboard: TensorboardLogger | None = None

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
        self._rows = _read_rows(self.path / PROGRESS, position)
        self._saved_steps = position.agent_steps
        return position.updates

    def prepare(self, config: TrainConfig) -> None:
        """Prepare the folder: remove files that are newer than the restored checkpoint, or all if none was restored."""
        self.path.mkdir(parents=True, exist_ok=True)
        if self._rows:
            self.checkpoints.sweep()
            lines = [list(self._rows[0]), *map(_texts, self._rows)]
            write_whole(self.path / PROGRESS, "".join(map(_line, lines)).encode())
        else:
            self.checkpoints.clear()
            for name in (PROGRESS, CURVE, WEIGHTS):
                (self.path / name).unlink(missing_ok=True)
        save_config(self.path, config)
        self._start_tensorboard()

    @property
    def seconds(self) -> float:
        """Duration of the run in seconds, up to the latest row."""
        return self._rows[-1]["seconds"] if self._rows else 0.0

    def log(self, row: dict[str, float]) -> None:
        """Append one row to the progress file; all rows have the same keys."""
        lines = [_texts(row)] if self._rows else [list(row), _texts(row)]
        with (self.path / PROGRESS).open("a" if self._rows else "w", newline="") as file:
            file.write("".join(map(_line, lines)))
        self._rows.append(row)
        self._log_scalars(row)

    def save(self, learner: Learner, interval: int = 1) -> None:
        """Write a checkpoint if the latest is at least `interval` agent steps old."""
        if not self._rows or self._rows[-1]["agent_steps"] < self._saved_steps + interval:
            return
        score = self._recent_score() if "episodes" in self._rows[-1] else self._validation_score()
        position = Position(len(self._rows), int(self._rows[-1]["agent_steps"]), score)
        self.checkpoints.save(learner, position)
        self._saved_steps = position.agent_steps

    def finish(self, network: nn.Module) -> None:
        """Write the policy and the learning curve."""
        save_weights(self.path, network)
        if self._tensorboard is not None:
            self._tensorboard.experiment.close()
        if self._rows:
            self._draw_curve()

    def _start_tensorboard(self) -> None:
        """Rewrite TensorBoard's files from the rows so far, since events after the checkpoint cannot be removed."""
        shutil.rmtree(self.path / TENSORBOARD, ignore_errors=True)
        self._tensorboard = TensorboardLogger(TENSORBOARD, str(self.path))
        for row in self._rows:
            self._log_scalars(row)

    def _log_scalars(self, row: dict[str, float]) -> None:
        if self._tensorboard is not None:
            for name, value in row.items():
                if not math.isnan(value):
                    self._tensorboard.log_scalar(name, value, int(row["agent_steps"]))

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

    def _draw_curve(self) -> None:
        from matplotlib.figure import Figure

        figure = Figure(figsize=(7, 4), layout="constrained")
        rates = figure.add_subplot()
        steps = [row["agent_steps"] / 1e6 for row in self._rows]
        curves = {key: label for key, label in CURVES.items() if key in self._rows[0]}
        for key, label in curves.items():
            rates.plot(steps, [row[key] for row in self._rows], label=label)
        if "return" in self._rows[0]:
            returns = rates.twinx()
            returns.plot(steps, [row["return"] for row in self._rows], color="0.7", zorder=0)
            returns.set_ylabel("mean episode return per agent", color="0.5")
        lifelong = "throughput" in curves
        rates.set(xlabel="million agent steps", ylabel="training data", ylim=(0, None if lifelong else 1.02))
        rates.legend(loc="lower right")
        with replacing(self.path / CURVE) as temporary:
            figure.savefig(temporary, dpi=150)


def _read_rows(file: Path, position: Position) -> list[dict[str, float]]:
    """Return the rows up to `position`; raises `FormatError` if some are missing."""
    try:
        with file.open(newline="") as lines:
            rows = list(islice(csv.DictReader(lines), position.updates))
        numbers = [{key: float(value) for key, value in row.items()} for row in rows]
        last = numbers[-1]["agent_steps"]
    except (ValueError, TypeError, LookupError, csv.Error) as error:
        raise FormatError(file, f"damaged: {error}") from None
    if len(numbers) < position.updates or last != position.agent_steps:
        raise FormatError(file, f"expected {position.updates} rows, the last of agent step {position.agent_steps}")
    return numbers


def _texts(row: dict[str, float]) -> list[str]:
    """Format numbers with six digits, and counts in full."""
    return [f"{value:.0f}" if key == "agent_steps" else f"{value:.6g}" for key, value in row.items()]


def _line(cells: list[str]) -> str:
    return ",".join(cells) + "\r\n"
