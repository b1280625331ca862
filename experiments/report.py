"""Run the report's experiment in its own setting, and what makes it work: `make long RUN=report`.

Ten agents in the report's warehouse, with the report's observations, rewards and network, are trained by `central-ppo`
and by Stable-Baselines3. Then changes are added to `central-ppo` in sequence. All runs have the same length.
Finished runs are reused; the table and the figure include all of them.
"""

from __future__ import annotations

import csv
import json
import math
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.report_page import spread
from experiments.reproduction import Variation
from mapf_pz.rl.algorithms.algorithm import Algorithm
from mapf_pz.rl.algorithms.named import algorithm_of
from mapf_pz.rl.config import TrainConfig
from mapf_pz.rl.presets import PRESETS
from mapf_pz.rl.training.progress import PROGRESS
from mapf_pz.rl.training.ranks import Ranks
from mapf_pz.rl.training.train import train
from mapf_pz.rl.training.validation import Validation
from mapf_pz.simulator.config import REWARDS

ROOT = Path(__file__).parents[1]
IMAGE, SB3_EXAMPLE = ROOT / "docs" / "images" / "report.png", ROOT / "examples" / "report_sb3.py"
RESULTS = "results.json"
REPORT = Variation("`central-ppo`", PRESETS["report"])
SB3 = "Stable-Baselines3"
NUM_AGENTS = REPORT.config.task.num_agents
WINDOW = 16
"""Number of latest training episodes in a point of the reward curves."""


def changes() -> Iterator[Variation]:
    """Yield the changes of `central-ppo` in order; each row changes the row above it."""
    ours = PRESETS["central-ppo"]
    now = REPORT.with_(
        "+ learning rate, discount and coefficients of this project",
        optimization={name: getattr(ours.optimization, name) for name in ("learning_rate", "max_grad_norm")},
        ppo={name: getattr(ours.ppo, name) for name in ("gamma", "critic_coeff")},
    )
    yield now
    seen = now.config.task.env.channels
    now = now.with_("+ cost to go and heuristic observed", env={"channels": (*seen, "cost_to_go", "heuristic")})
    yield now
    yield (now := now.with_("+ reward for progress", env={"reward": REWARDS["progress"]}))
    yield (now := now.with_("+ credit for each agent", ppo={"credit": "agent"}))
    yield (now := Variation("+ one policy shared by the agents: `mappo`", replace(now.config, algorithm="mappo")))
    yield now.with_(
        "+ 3 x 3 convolutions on 7 x 7 cells",
        env={"view_size": (7, 7), "view": "centered"},
        model={"encoder": "conv"},
    )


@dataclass(frozen=True)
class Options:
    """Options of the experiment."""

    output: Path = Path("runs/report-experiment")
    """Folder of all runs."""
    agent_steps: int = 300_000
    """Length of each training in agent steps, ten to an environment step."""
    seeds: tuple[int, ...] = (0, 1, 2)
    """Random seeds of the report's setting."""
    change_seeds: tuple[int, ...] = (0,)
    """Random seeds of the changes."""


def main(options: Options) -> None:
    """Train the missing runs in sequence, print the table, and draw the figure."""
    for seed in options.seeds:
        learn(REPORT, seed, options)
        learn_sb3(seed, options)
    for seed in options.change_seeds:
        for row in changes():
            learn(row, seed, options)
    names = dict.fromkeys((REPORT.name, SB3), options.seeds)
    names |= {row.name: options.change_seeds for row in changes()}
    runs = {name: [folder(options, name, seed) for seed in seeds] for name, seeds in names.items()}
    print("\n".join(table(runs)))
    draw(runs)


def folder(options: Options, name: str, seed: int) -> Path:
    """Return the folder of a run."""
    words = "".join(char if char.isalnum() else " " for char in name).split()
    return options.output / f"{'-'.join(words)}-{seed}"


def learn(row: Variation, seed: int, options: Options) -> None:
    """Train a variation, unless its run exists."""
    output = folder(options, row.name, seed)
    if (output / RESULTS).exists():
        return
    before: dict[str, float] = {}

    def measured(config: TrainConfig) -> Algorithm:
        algorithm = algorithm_of(config.algorithm)(config)
        before.update(Validation(algorithm, config, Ranks()).measure())
        return algorithm

    steps = options.agent_steps
    config = replace(row.config, seed=seed, agent_steps=steps, validation_interval=steps)
    began = time.process_time()
    train(config, output, make_algorithm=measured, overwrite=True)
    after = read_progress(output)[-1]
    results: dict[str, Any] = {when: _means(values) for when, values in (("before", before), ("after", after))}
    _finish(output, results | {"cpu_seconds": time.process_time() - began})


def learn_sb3(seed: int, options: Options) -> None:
    """Train with Stable-Baselines3, unless the run exists."""
    output = folder(options, SB3, seed)
    if (output / RESULTS).exists():
        return
    steps = f"--steps={options.agent_steps // NUM_AGENTS}"
    subprocess.run([sys.executable, SB3_EXAMPLE, steps, f"--seed={seed}", f"--output={output}"], check=True)


def _means(row: dict[str, float]) -> dict[str, float]:
    """Return the CSR, the ISR and the reward, the sum over agents, of a validation."""
    csr, isr, mean = (row[f"validation_{name}"] for name in ("CSR", "ISR", "return"))
    return {"CSR": csr, "ISR": isr, "reward": NUM_AGENTS * mean}


def _finish(output: Path, results: dict[str, Any]) -> None:
    (output / RESULTS).write_text(json.dumps(results, indent=2) + "\n")
    print(output, json.dumps(results), flush=True)


def read_progress(run: Path) -> list[dict[str, float]]:
    """Return the progress of a run; empty cells are NaN."""
    with (run / PROGRESS).open(newline="") as file:
        return [{key: float(value or "nan") for key, value in row.items()} for row in csv.DictReader(file)]


def table(runs: dict[str, list[Path]]) -> Iterator[str]:
    """Yield the results before and after training as Markdown: means over the seeds, with minimum and maximum."""
    yield "| setting | CSR | ISR | reward of an episode | CPU minutes |"
    yield "| --- | --- | --- | --- | --- |"
    for name, folders in runs.items():
        results = [json.loads((run / RESULTS).read_text()) for run in folders]
        cells = [
            " → ".join(spread([result[when][key] for result in results], digits) for when in ("before", "after"))
            for key, digits in (("CSR", 2), ("ISR", 2), ("reward", 0))
        ]
        minutes = np.mean([result["cpu_seconds"] for result in results]) / 60
        yield f"| {name} | {' | '.join(cells)} | {minutes:.1f} |"


def draw(runs: dict[str, list[Path]]) -> None:
    """Plot the reward of the report's setting, as in its Figure 6, and the ISR of all settings."""
    figure = Figure(figsize=(13, 4.5), layout="constrained")
    rewards, rates = figure.subplots(1, 2)
    ours = [training_curve(run, "return") * (1, NUM_AGENTS) for run in runs[REPORT.name]]
    _draw_range(rewards, ours, _label(REPORT.name), "C0")
    _draw_range(rewards, [sb3_reward_curve(run) for run in runs[SB3]], SB3, "C7")
    rewards.set(ylabel="reward (sum over agents)", title="the report's setting")
    rows = [name for name in runs if name != SB3]
    for k, name in enumerate(rows):
        _draw_range(rates, [training_curve(run, "ISR") for run in runs[name]], _label(name), f"C{k}")
    rates.set(ylabel="agents at their goals (ISR)", ylim=(-0.02, 1.02), title="one change at a time")
    for panel in (rewards, rates):
        panel.set_xlabel(f"thousand environment steps (means of the latest {WINDOW} training episodes)")
        panel.legend(fontsize=8)
    figure.savefig(IMAGE, dpi=90)


def _label(name: str) -> str:
    return name.replace("`", "")


def _draw_range(axes: Axes, curves: list[np.ndarray], label: str, color: str) -> None:
    """Plot the mean and the range of curves (T, 2) over their common environment steps."""
    steps = curves[0][:, 0]
    values = np.stack([np.interp(steps, *curve.T) for curve in curves])
    axes.plot(steps / 1000, values.mean(0), color=color, label=label)
    axes.fill_between(steps / 1000, values.min(0), values.max(0), color=color, alpha=0.2, linewidth=0)


def training_curve(run: Path, column: str) -> np.ndarray:
    """Return environment steps and the mean of a column of progress over the latest training episodes, (T, 2)."""
    rows = [row for row in read_progress(run) if row["episodes"]]
    counts = [int(row["episodes"]) for row in rows]
    values = np.repeat([row[column] for row in rows], counts)
    means = [values[max(0, count - WINDOW) : count].mean() for count in np.cumsum(counts)]
    return np.column_stack([[row["agent_steps"] / NUM_AGENTS for row in rows], means])


def sb3_reward_curve(run: Path) -> np.ndarray:
    """Return environment steps and the mean reward over the latest training episodes, (T, 2)."""
    points = [(row["time/total_timesteps"], row["rollout/ep_rew_mean"]) for row in read_progress(run)]
    return np.array([point for point in points if not math.isnan(point[1])])


if __name__ == "__main__":
    main(tyro.cli(Options))
