"""Measure what agents gain from each other's information: `python -m experiments.ideas.sharing`.

Policies differ in what each agent knows of the others: what is in its own view, also the observations of its nearest
neighbors, or embeddings that agents exchange within a radius, or all of them, which makes the policy a centralized one.
They imitate LaCAM or learn by PPO, at two densities of obstacles, with three seeds. Validation is without the safety
layer. `docs/results/sharing.csv` gets the validations of each run as soon as it is finished; its runs are not repeated.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro
from matplotlib.figure import Figure

from experiments.pages import FILES
from experiments.report.reproduction import Variation
from experiments.study import Study, StudyOptions, folder
from mapf_pz.instances.mixture import MapMixture
from mapf_pz.rl.config import ImitationConfig, TrainConfig
from mapf_pz.rl.presets import PRESETS
from mapf_pz.rl.progress import read_progress
from mapf_pz.rl.training.train import train

IMAGE = FILES.parent / "images" / "sharing.png"
NUM_NEIGHBORS, RADII = (1, 2, 4), (0, 3, 5, None)
DENSITIES = (0.15, 0.3)
AGENT_STEPS = {"dagger": 150_000, "mappo": 600_000}
"""Length of a training by imitation and by PPO."""
VALIDATIONS = 5
METRICS = ("CSR", "ISR", "return")
STUDY = Study(FILES / "sharing.csv", ("algorithm", "density", "knows", "seed"), ("agent_steps", *METRICS))
"""The validations of each run."""


@dataclass(frozen=True)
class Options(StudyOptions):
    """Options of the experiment."""

    output: Path = Path("runs/sharing")
    """Folder of all runs."""
    seeds: tuple[int, ...] = (0, 1, 2)
    """Random seeds."""
    algorithms: tuple[str, ...] = tuple(AGENT_STEPS)
    """Imitation (`dagger`), PPO (`mappo`), or both."""


def base(algorithm: str, density: float) -> TrainConfig:
    """Return the configuration without sharing: 8 agents on random 10 x 10 maps."""
    preset, steps = PRESETS["central"], AGENT_STEPS[algorithm]
    optimization = PRESETS["mappo"].optimization
    if algorithm == "dagger":
        optimization = replace(preset.optimization, steps_per_batch=16, minibatch_size=32, learning_rate=1e-3)
    return replace(
        preset,
        algorithm=algorithm,
        task=replace(
            preset.task,
            env=replace(preset.task.env, num_agents=8, max_steps=64),
            mixture=MapMixture(height=10, width=10, density=density),
        ),
        model=replace(preset.model, communication=0),
        optimization=optimization,
        ppo=PRESETS["mappo"].ppo,
        imitation=ImitationConfig(expert="lacam:time_limit=0.05", expert_share=0.5, temperature=0.3),
        initial_temperature=1.0,
        agent_steps=steps,
        validation_interval=steps // VALIDATIONS,
        validation_episodes=256,
    )


def rows(algorithm: str, density: float) -> Iterator[Variation]:
    """Yield what agents know of each other, from the least to the most."""
    alone = Variation("own view", base(algorithm, density))
    yield alone
    for number in NUM_NEIGHBORS:
        yield alone.with_(f"observations of {number} nearest", env={"num_neighbors": number})
    for radius in RADII:
        name = "embeddings of all" if radius is None else f"embeddings within {radius} cells"
        yield alone.with_(name, model={"communication": 2, "communication_radius": radius})


def main(options: Options) -> None:
    """Train the missing runs in sequence; write the validations after each, and the figure at the end."""
    if not options.write:
        for seed, algorithm, density in itertools.product(options.seeds, options.algorithms, DENSITIES):
            learn(algorithm, density, seed, options.output)
    draw(STUDY.rows())


def learn(algorithm: str, density: float, seed: int, output: Path) -> None:
    """Train the missing runs that differ in what agents know of each other."""
    configs = {(algorithm, density, row.name, seed): row.config for row in rows(algorithm, density)}
    for run in STUDY.missing(configs):
        where = folder(output, f"{algorithm}-{density}-{run[2]}", seed)
        train(replace(configs[run], seed=seed), where, overwrite=True)
        STUDY.add(run, *_validations(where))


def _validations(run: Path) -> Iterator[dict[str, str]]:
    """Yield a run's validations."""
    for row in read_progress(run):
        if not np.isnan(row["validation_CSR"]):
            numbers = {metric: f"{row[f'validation_{metric}']:.3f}" for metric in METRICS}
            yield {"agent_steps": f"{row['agent_steps']:.0f}"} | numbers


def draw(validations: Sequence[Mapping[str, str]]) -> None:
    """Plot the CSR over the agent steps, mean and range of the seeds: a panel for each algorithm and density."""
    figure = Figure(figsize=(13, 8), layout="constrained")
    panels = figure.subplots(len(AGENT_STEPS), len(DENSITIES), sharex="row", sharey=True, squeeze=False)
    titles = {"dagger": "imitation of LaCAM", "mappo": "PPO"}
    for i, algorithm in enumerate(AGENT_STEPS):
        for j, density in enumerate(DENSITIES):
            panel = panels[i, j]
            for k, row in enumerate(rows(algorithm, density)):
                steps, mean, low, high = _curve(validations, (algorithm, str(density), row.name))
                panel.plot(steps, mean, color=f"C{k}", label=row.name)
                panel.fill_between(steps, low, high, color=f"C{k}", alpha=0.12, linewidth=0)
            panel.set(title=f"{titles[algorithm]}, {density:.0%} obstacles", xlabel="thousand agent steps")
            panel.set_ylabel("all agents at their goals (CSR)" if j == 0 else None)
    panels[0, 0].legend(fontsize=8)
    figure.savefig(IMAGE, dpi=90)


def _curve(validations: Sequence[Mapping[str, str]], setting: tuple[str, str, str]) -> tuple[np.ndarray, ...]:
    """Return thousands of agent steps, and the mean, minimum and maximum of the CSR over the seeds."""
    chosen = [row for row in validations if (row["algorithm"], row["density"], row["knows"]) == setting]
    seeds = dict.fromkeys(row["seed"] for row in chosen)
    steps = np.array([float(row["agent_steps"]) for row in chosen if row["seed"] == next(iter(seeds))]) / 1000
    rates = np.array([[float(row["CSR"]) for row in chosen if row["seed"] == seed] for seed in seeds])
    return steps, rates.mean(0), rates.min(0), rates.max(0)


if __name__ == "__main__":
    main(tyro.cli(Options))
