"""Loggers of a run's progress beside `progress.csv`: TensorBoard, Weights & Biases, MLflow."""

from __future__ import annotations

import math
import os
import secrets
import shutil
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final, Protocol

from torchrl.record.loggers.tensorboard import TensorboardLogger

from mapf_pz._internal.atomic import write_whole
from mapf_pz.rl.config import LoggerName, TrainConfig
from mapf_pz.rl.config_file import config_values
from mapf_pz.rl.progress import Row

TENSORBOARD: Final = "tensorboard"
WANDB: Final = "wandb"
MLFLOW: Final = "mlflow"
LOGGER_FOLDERS = (TENSORBOARD, WANDB, MLFLOW)
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
    """Logs to Weights & Biases.

    A resumed run continues its run there. Rows after the checkpoint, which cannot be removed there, are logged twice.
    """

    def __init__(self, folder: Path, config: TrainConfig, rows: Sequence[Row]) -> None:
        """Start a run, or continue it if there are rows already."""
        wandb: Any = import_module(WANDB)
        tracking = config.tracking
        self._run: Any = wandb.init(
            id=_run_id(folder / WANDB, rows) or _save_run_id(folder / WANDB, secrets.token_hex(4)),
            resume="allow",
            project=tracking.project,
            group=tracking.group,
            name=tracking.run_name or folder.name,
            tags=list(tracking.tags),
            dir=folder,
            config=config_values(config),
        )
        self._run.define_metric("*", step_metric="agent_steps")

    def log(self, row: Row) -> None:
        """Log one row."""
        self._run.log(_numbers(row))

    def close(self) -> None:
        """Finish the run."""
        self._run.finish()


class MLflow:
    """Logs to MLflow, a step of which is an agent step.

    A resumed run continues its run there. Rows after the checkpoint, which cannot be removed there, are logged twice.
    """

    def __init__(self, folder: Path, config: TrainConfig, rows: Sequence[Row]) -> None:
        """Start a run, or continue it if there are rows already."""
        self._entities: Any = import_module("mlflow.entities")
        self._client: Any = import_module(MLFLOW).MlflowClient()
        self._id = _run_id(folder / MLFLOW, rows) or _save_run_id(folder / MLFLOW, self._start(folder.name, config))

    def _start(self, folder_name: str, config: TrainConfig) -> str:
        """Start a run with the configuration as its parameters, and return its ID."""
        client, tracking = self._client, config.tracking
        name = tracking.project or os.environ.get("MLFLOW_EXPERIMENT_NAME", "Default")
        experiment = client.get_experiment_by_name(name)
        tags = dict.fromkeys(tracking.tags, "true") | ({} if tracking.group is None else {"group": tracking.group})
        run = client.create_run(
            client.create_experiment(name) if experiment is None else experiment.experiment_id,
            run_name=tracking.run_name or folder_name,
            tags=tags,
        )
        for key, value in _flat(config_values(config)):
            client.log_param(run.info.run_id, key, value)
        return run.info.run_id

    def log(self, row: Row) -> None:
        """Log one row."""
        step, now = int(row["agent_steps"]), time.time_ns() // 1_000_000
        metrics = [self._entities.Metric(name, value, now, step) for name, value in _numbers(row).items()]
        self._client.log_batch(self._id, metrics)

    def close(self) -> None:
        """Finish the run."""
        self._client.set_terminated(self._id)


_LOGGERS: dict[LoggerName, Callable[[Path, TrainConfig, Sequence[Row]], ProgressLogger]] = {
    TENSORBOARD: TensorBoard,
    WANDB: WeightsAndBiases,
    MLFLOW: MLflow,
}


def check_loggers(config: TrainConfig) -> None:
    """Raise `ImportError` if a logger's package is not installed."""
    for name in config.loggers:
        spec = find_spec(name)  # a folder of this name is found, too, without an origin
        if spec is None or spec.origin is None:
            raise ImportError(f"loggers: {name!r} is not installed: pip install {name}")


def make_loggers(folder: Path, config: TrainConfig, rows: Sequence[Row]) -> list[ProgressLogger]:
    """Create the loggers of a run whose progress so far are `rows`."""
    return [_LOGGERS[name](folder, config, rows) for name in config.loggers]


def _run_id(folder: Path, rows: Sequence[Row]) -> str | None:
    """Return the ID that a run with these rows has in a service; otherwise, remove that of an earlier one."""
    file = folder / _RUN_ID
    if rows and file.exists():
        return file.read_text()
    shutil.rmtree(folder, ignore_errors=True)
    return None


def _save_run_id(folder: Path, run_id: str) -> str:
    folder.mkdir()
    write_whole(folder / _RUN_ID, run_id.encode())
    return run_id


def _flat(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield nested values with names such as `optimization.learning_rate`."""
    for name, value in values.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield prefix + name, value


def _numbers(row: Row) -> dict[str, float]:
    return {name: value for name, value in row.items() if not math.isnan(value)}
