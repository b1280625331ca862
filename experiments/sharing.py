"""Measure what agents gain from each other's information: `PYTHONPATH=. python -m experiments.sharing`.

Policies imitate LaCAM, for the same number of agent steps on the same maps. They differ in what each agent knows of the
others: what is in its own view, also the observations of its nearest neighbors, or embeddings that agents exchange
within a radius, or all of them, which makes the policy a centralized one. Validation is without the safety layer.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro

from experiments.report import read_progress
from experiments.reproduction import Variation
from mapf_pz.instances.mixture import MapMixture
from mapf_pz.rl.config import ImitationConfig, TrainConfig
from mapf_pz.rl.presets import PRESETS
from mapf_pz.rl.training.train import train

NUM_NEIGHBORS, RADII = (1, 2, 4), (3, 5, None)
METRICS = ("CSR", "ISR", "return")


@dataclass(frozen=True)
class Options:
    """Options of the experiment."""

    output: Path = Path("runs/sharing")
    """Folder of all runs."""
    agent_steps: int = 150_000
    """Length of each training in agent steps."""
    seeds: tuple[int, ...] = (0,)
    """Random seeds."""


def base(agent_steps: int) -> TrainConfig:
    """Return the configuration without sharing: 8 agents on random 10 x 10 maps, 30 % of which are obstacles."""
    preset = PRESETS["central"]
    return replace(
        preset,
        algorithm="dagger",
        task=replace(
            preset.task,
            env=replace(preset.task.env, num_agents=8, max_steps=64),
            mixture=MapMixture(height=10, width=10, density=0.3),
        ),
        model=replace(preset.model, communication=0),
        optimization=replace(preset.optimization, steps_per_batch=16, minibatch_size=32, learning_rate=1e-3),
        imitation=ImitationConfig(expert="lacam:time_limit=0.05", expert_share=0.5, temperature=0.3),
        initial_temperature=1.0,
        agent_steps=agent_steps,
        validation_interval=agent_steps,
        validation_episodes=256,
    )


def rows(agent_steps: int) -> Iterator[Variation]:
    """Yield what agents know of each other, from the least to the most."""
    alone = Variation("own view", base(agent_steps))
    yield alone
    for number in NUM_NEIGHBORS:
        yield alone.with_(f"observations of {number} nearest", env={"num_neighbors": number})
    for radius in RADII:
        name = "embeddings of all (centralized)" if radius is None else f"embeddings within {radius} cells"
        yield alone.with_(name, model={"communication": 2, "communication_radius": radius})


def main(options: Options) -> None:
    """Train the missing runs in sequence, and print the table: means over the seeds."""
    print("| each agent knows | CSR | ISR | return | minutes |\n| --- | --- | --- | --- | --- |", flush=True)
    for row in rows(options.agent_steps):
        runs = [options.output / f"{row.name.split(' (')[0].replace(' ', '-')}-{seed}" for seed in options.seeds]
        for run, seed in zip(runs, options.seeds, strict=True):
            if not (run / "policy.safetensors").exists():
                train(replace(row.config, seed=seed), run, overwrite=True)
        last = [read_progress(run)[-1] for run in runs]
        means = [np.mean([values[f"validation_{name}"] for values in last]) for name in METRICS]
        minutes = np.mean([values["seconds"] for values in last]) / 60
        print(f"| {row.name} | {' | '.join(f'{mean:.3f}' for mean in means)} | {minutes:.1f} |", flush=True)


if __name__ == "__main__":
    main(tyro.cli(Options))
