"""Loggers of a run's progress in other formats than `progress.csv`: TensorBoard and Weights & Biases."""

from __future__ import annotations

import math
import secrets
import shutil
from collections.abc import Callable, Sequence
from importlib import import_module
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Any, Protocol

from torchrl.record.loggers.tensorboard import TensorboardLogger

from mapf_pz._internal.atomic import write_whole
from mapf_pz.rl.config import LoggerName, TrainConfig
from mapf_pz.rl.config_file import config_values
from mapf_pz.rl.progress import Row

TENSORBOARD, WANDB = "tensorboard", "wandb"
LOGGER_FOLDERS = (TENSORBOARD, WANDB)
"""Folders that loggers write into a run's folder."""
_RUN_ID = "run-id.txt"


class ProgressLogger(Protocol):
    """Logs the rows of a run's progress."""

    def log(self, row: Row) -> None:
        """Log one row; NaN values are omitted."""

    def close(self) -> None:
        """Write what has not been written yet."""


class TensorBoard:
    """Writes files for `tensorboard --logdir RUN`."""

    def __init__(self, folder: Path, _: TrainConfig, rows: Sequence[Row]) -> None:
        """Write all rows so far again, since events after the checkpoint cannot be removed."""
        shutil.rmtree(folder / TENSORBOARD, ignore_errors=True)
        self._logger = TensorboardLogger(TENSORBOARD, str(folder))
        for row in rows:
            self.log(row)

    def log(self, row: Row) -> None:
        """Log one row."""
        for name, value in _numbers(row).items():
            self._logger.log_scalar(name, value, int(row["agent_steps"]))

    def close(self) -> None:
        """Close the file."""
        self._logger.experiment.close()


class WeightsAndBiases:
    """Logs to Weights & Biases, which its environment variables configure, such as `WANDB_PROJECT` and `WANDB_MODE`.

    A resumed run continues its run there. Rows after the checkpoint, which cannot be removed there, are logged twice.
    """

    def __init__(self, folder: Path, config: TrainConfig, rows: Sequence[Row]) -> None:
        """Start a run, or continue it if there are rows already."""
        wandb: Any = import_module(WANDB)
        file = folder / WANDB / _RUN_ID
        if not (rows and file.exists()):
            shutil.rmtree(folder / WANDB, ignore_errors=True)
            file.parent.mkdir()
            write_whole(file, secrets.token_hex(4).encode())
        values = config_values(config)
        self._run: Any = wandb.init(id=file.read_text(), resume="allow", name=folder.name, dir=folder, config=values)
        self._run.define_metric("*", step_metric="agent_steps")

    def log(self, row: Row) -> None:
        """Log one row."""
        self._run.log(_numbers(row))

    def close(self) -> None:
        """Finish the run."""
        self._run.finish()


_LOGGERS: dict[LoggerName, Callable[[Path, TrainConfig, Sequence[Row]], ProgressLogger]] = {
    "tensorboard": TensorBoard,
    "wandb": WeightsAndBiases,
}


def check_loggers(config: TrainConfig) -> None:
    """Raise `ImportError` if a logger's package is not installed."""
    if "wandb" in config.loggers:
        try:
            distribution("wandb")
        except PackageNotFoundError:
            raise ImportError("loggers: 'wandb' is not installed: pip install wandb") from None


def make_loggers(folder: Path, config: TrainConfig, rows: Sequence[Row]) -> list[ProgressLogger]:
    """Create the loggers of a run whose progress so far are `rows`."""
    return [_LOGGERS[name](folder, config, rows) for name in config.loggers]


def _numbers(row: Row) -> dict[str, float]:
    return {name: value for name, value in row.items() if not math.isnan(value)}
