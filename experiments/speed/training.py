"""The speed of training in agent steps per second."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from mapf_pz.rl.config import (
    CollectorName,
    DeviceName,
    ModelConfig,
    ObservationPrecision,
    PrecisionName,
    TrainConfig,
)
from mapf_pz.rl.presets import PRESETS
from mapf_pz.rl.training.train import train

SMALL, LARGE = (256, 64), (2048, 256)
"""Minibatch size and number of environments."""
CONV = ModelConfig(conv_channels=(64, 64), hidden=256, head=(256,))
RESIDUAL = ModelConfig(encoder="residual", conv_channels=(64, 64), num_blocks=2, hidden=512, head=(512,))


def configs() -> dict[str, TrainConfig]:
    """Return the configurations: two presets, and variants of `mappo` with larger minibatches, batches and networks."""
    preset = PRESETS["mappo"]

    def changed(model: ModelConfig, minibatch_size: int, num_envs: int) -> TrainConfig:
        optimization = replace(preset.optimization, minibatch_size=minibatch_size, num_envs=num_envs)
        return replace(preset, model=model, optimization=optimization)

    return {
        "quickstart": PRESETS["quickstart"],
        "preset": preset,
        "minibatches of 2048": changed(preset.model, LARGE[0], SMALL[1]),
        "256 environments": changed(preset.model, *LARGE),
        "256 environments, convolutions of 64 and 64, 256 features": changed(CONV, *LARGE),
        "256 environments, residual, 512 features": changed(RESIDUAL, *LARGE),
    }


def main(
    device: DeviceName = "auto",
    precision: PrecisionName | None = None,
    num_learners: tuple[int, ...] = (1,),
    updates: int = 5,
    runs: tuple[str, ...] = (),
    observation_precision: ObservationPrecision = "float32",
    compile: bool = False,
    collector: CollectorName = "single",
    num_workers: int = 1,
    overlap: bool = False,
) -> None:
    """Train each run for a few updates, and print the rate from the second update on.

    The first update includes compilation.

    Args:
        device: device of the networks.
        precision: precision of learning. Default: that of the run.
        num_learners: numbers of processes to train in, in sequence.
        updates: number of updates, at least 3.
        runs: names of the runs. Default: all.
        observation_precision: precision in which observations are stored and sent to the device.
        compile: whether the loss is compiled.
        collector: where environments are stepped.
        num_workers: number of workers of the collectors `processes` and `ray`.
        overlap: whether the workers collect the next batch during an update.
    """
    options: dict[str, Any] = {
        "device": device,
        "observation_precision": observation_precision,
        "compile": compile,
        "collector": collector,
        "num_workers": num_workers,
        "overlap": overlap,
    }
    for name, config in configs().items():
        for number in num_learners if not runs or name in runs else ():
            length = updates * config.steps_per_update
            config = replace(config, **options, agent_steps=length, num_learners=number)
            print(f"{name}, {number} learners: {_speed(replace(config, precision=precision or config.precision))}")


def _speed(config: TrainConfig) -> str:
    """Return the rate of a run, and the shares of the time of its last update."""
    moments: list[float] = []
    rows: list[dict[str, float]] = []

    def record(row: dict[str, float]) -> None:
        moments.append(time.perf_counter())
        rows.append(row)

    with TemporaryDirectory() as folder:
        train(config, Path(folder) / "run", record)
    rate = config.steps_per_update * (len(rows) - 1) / (moments[-1] - moments[0])
    shares = ", ".join(f"{part} {rows[-1][f'{part}_share']:.2f}" for part in ("collecting", "acting", "learning"))
    return f"{rate:,.0f} agent steps per second; {shares}"
