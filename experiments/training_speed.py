"""Measure the speed of training in agent steps per second: `python -m experiments.training_speed --device cuda`."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import tyro

from mapf_pz.rl.config import DeviceName, ModelConfig, TrainConfig
from mapf_pz.rl.presets import PRESETS
from mapf_pz.rl.train import train

SMALL, LARGE = (256, 64), (2048, 256)
"""Minibatch size and number of environments."""
CONV = ModelConfig(conv_channels=(64, 64), hidden=256, head=(256,))
RESIDUAL = ModelConfig(encoder="residual", conv_channels=(64, 64), num_blocks=2, hidden=512, head=(512,))


def configs() -> dict[str, TrainConfig]:
    """Return the configurations: the preset `mappo`, and variants with larger minibatches, batches and networks."""
    preset = PRESETS["mappo"]

    def changed(model: ModelConfig, minibatch_size: int, num_envs: int) -> TrainConfig:
        optimization = replace(preset.optimization, minibatch_size=minibatch_size, num_envs=num_envs)
        return replace(preset, model=model, optimization=optimization)

    return {
        "preset": preset,
        "minibatches of 2048": changed(preset.model, LARGE[0], SMALL[1]),
        "256 environments": changed(preset.model, *LARGE),
        "256 environments, convolutions of 64 and 64, 256 features": changed(CONV, *LARGE),
        "256 environments, residual, 512 features": changed(RESIDUAL, *LARGE),
    }


def measure(device: DeviceName = "auto", updates: int = 5, runs: tuple[str, ...] = ()) -> None:
    """Train each run for a few updates, and print the rate from the second update on.

    Args:
        device: device of the networks.
        updates: number of updates, at least 3.
        runs: names of the runs. Default: all.
    """
    for name, config in configs().items():
        if runs and name not in runs:
            continue
        config = replace(config, device=device, agent_steps=updates * config.steps_per_update)
        moments: list[float] = []
        rows: list[dict[str, float]] = []

        def record(row: dict[str, float], moments: list[float] = moments, rows: list[dict[str, float]] = rows) -> None:
            moments.append(time.perf_counter())
            rows.append(row)

        with TemporaryDirectory() as folder:
            train(config, Path(folder) / "run", record)
        rate = config.steps_per_update * (updates - 1) / (moments[-1] - moments[0])
        shares = ", ".join(f"{part} {rows[-1][f'{part}_share']:.2f}" for part in ("collecting", "acting", "learning"))
        print(f"{name}: {rate:,.0f} agent steps per second; {shares}", flush=True)


if __name__ == "__main__":
    tyro.cli(measure)
