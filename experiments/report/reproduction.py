"""Reproduce and analyze the report's experiment: `make -f experiments/Makefile reproduction`.

It starts with the setting of the report's published code, removes the causes of its failure one at a time, and then
adds changes that improve learning, and the report's ideas for future work. The task is always the same: 4 agents on
random 8 x 8 maps with 10 % obstacles, at most 64 steps. Every variation is trained with three seeds. Existing runs are
reused; the table and the figure include all of them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from matplotlib.figure import Figure

from experiments.report.flaws import AllGoals, Bytes, Flaw, FlawedPPO, Freeze
from mapf_pz.rl.config import OptimizationConfig, PPOConfig, TrainConfig
from mapf_pz.rl.presets import PRESETS
from mapf_pz.rl.progress import PROGRESS, read_progress
from mapf_pz.rl.training.train import train
from mapf_pz.simulator.config import REWARDS, RewardConfig

DOCS = Path(__file__).parents[2] / "docs"
FULL = PRESETS["central-ppo"]

AS_CODED = TrainConfig(
    task=replace(
        FULL.task,
        env=replace(
            FULL.task.env,
            view="front",
            channels=("view", "goal", "orientation", "edge_weights", "other_goals"),
            features=(),
            edge_weights="random",
            reward=RewardConfig(pay_blocked_forward=True),
        ),
        action_mode="affine",
    ),
    algorithm="central-ppo",
    model=FULL.model,
    # As in its training script for Stable-Baselines3, except for batches (512 steps there) and minibatches (128 there).
    optimization=OptimizationConfig(
        num_envs=64,
        steps_per_batch=32,
        num_epochs=10,
        minibatch_size=512,
        learning_rate=2.5e-4,
        max_grad_norm=5.0,
    ),
    ppo=PPOConfig(
        gamma=0.9999,
        entropy_coeff=0.0,
        critic_coeff=0.19,
        credit="team",
    ),
)


@dataclass(frozen=True)
class Variation:
    """One row of the table."""

    name: str
    config: TrainConfig
    flaws: tuple[type[Flaw], ...] = ()

    def with_(self, name: str, without: type[Flaw] | None = None, **changes: Any) -> Variation:
        """Return a changed variation; `changes` are by part of the configuration, such as `ppo={"gamma": 0.9}`.

        `env` refers to the environment of the task.
        """
        if "env" in changes:
            changes["task"] = {"env": replace(self.config.task.env, **changes.pop("env"))} | changes.get("task", {})
        parts = {part: replace(getattr(self.config, part), **fields) for part, fields in changes.items()}
        return Variation(name, replace(self.config, **parts), tuple(flaw for flaw in self.flaws if flaw is not without))


def variations() -> Iterator[Variation]:
    """Yield the rows in order."""
    now = Variation("as coded", AS_CODED, (Bytes, AllGoals, Freeze))
    yield Variation("as printed", AS_CODED).with_(
        "as printed", task={"action_mode": "sigmoid"}, env={"reward": RewardConfig()}
    )
    yield now
    yield (now := now.with_("- observations as bytes", without=Bytes))
    yield (now := now.with_("- reward for driving into walls", env={"reward": RewardConfig()}))
    yield (now := now.with_("- actions drawn from the matrix: argmax", task={"action_mode": "argmax"}))
    yield (now := now.with_("- agents that freeze", without=Freeze))
    yield (now := now.with_("- all goals alike", without=AllGoals))
    ours = replace(now.config, optimization=FULL.optimization, ppo=replace(FULL.ppo, credit="team"))
    yield (now := Variation("+ PPO's settings of this project", ours))
    yield (now := now.with_("+ reward for progress", env={"reward": REWARDS["progress"], "edge_weights": "uniform"}))
    yield (now := now.with_("+ credit for each agent", ppo={"credit": "agent"}))
    seen = now.config.task.env.channels
    yield (now := now.with_("+ idea 3: goal and own location", env={"features": ("goal_vector", "location")}))
    known = {"channels": (*seen, "cost_to_go"), "features": ("goal_vector", "location", "action_advantage")}
    yield (now := now.with_("+ idea 2: cost to go", env=known))
    past = {"features": (*now.config.task.env.features, "last_actions"), "num_last_actions": 2}
    yield (now := now.with_("+ idea 5: past actions", env=past))
    full = Variation("central-ppo", FULL)
    yield full
    yield from ideas(full)
    yield full.with_("central-ppo: credit for the team", ppo={"credit": "team"})
    for mode in ("affine", "softmax"):
        yield full.with_(f"central-ppo: actions drawn: {mode}", task={"action_mode": mode})


def ideas(full: Variation) -> Iterator[Variation]:
    """Yield the report's ideas for future work that `central-ppo` lacks, each added to it separately."""
    features = full.config.task.env.features
    yield full.with_("central-ppo: idea 1: edge weights, crisscross", env={"edge_weights": "crisscross"})
    yield full.with_(
        "central-ppo: idea 3: goal and own location", env={"features": (*features, "goal_vector", "location")}
    )
    for kind in ("rnd", "inverse-dynamics"):
        yield full.with_(f"central-ppo: idea 4: curiosity, {kind}", curiosity={"kind": kind})
    yield full.with_("central-ppo: idea 5: three frames", env={"num_frames": 3})
    yield full.with_("central-ppo: idea 5: a GRU", model={"recurrent": 64})
    yield full.with_(
        "central-ppo: idea 6: residual network", model={"encoder": "residual", "conv_channels": (32,), "num_blocks": 1}
    )


@dataclass(frozen=True)
class Options:
    """Options of the reproduction."""

    output: Path = Path("runs/reproduction")
    """Folder of all runs."""
    jobs: int = 2
    """Number of parallel trainings."""
    agent_steps: int = 500_000
    """Length of each training in agent steps."""
    seeds: tuple[int, ...] = (0, 1, 2)
    """Random seeds of the trainings."""


def main(options: Options) -> None:
    """Train the missing runs, and write the table and the figure."""
    with ProcessPoolExecutor(options.jobs, get_context("spawn")) as pool:
        pending = [pool.submit(learn, row, seed, options) for seed in options.seeds for row in variations()]
        for run in pending:
            run.result()
    results = {row.name: [curve(folder(options, row, seed)) for seed in options.seeds] for row in variations()}
    write_table(results)
    draw_curves(results)


def folder(options: Options, row: Variation, seed: int) -> Path:
    """Return the folder of a run."""
    name = "".join(char if char.isalnum() else "-" for char in row.name)
    return options.output / f"{name.strip('-')}-{seed}"


def learn(row: Variation, seed: int, options: Options) -> None:
    """Train a variation, unless its run exists."""
    output = folder(options, row, seed)
    if (output / PROGRESS).exists() and curve(output)[-1][0] > 0.95 * options.agent_steps:
        return
    config = replace(
        row.config, seed=seed, agent_steps=options.agent_steps, validation_interval=options.agent_steps // 5
    )
    train(config, output, make_algorithm=lambda config: FlawedPPO(config, row.flaws), overwrite=True)
    print(row.name, seed, *(f"{value:.3f}" for value in curve(output)[-1][1:]), flush=True)


Curve = list[tuple[float, float, float]]
"""Agent steps, CSR and ISR of each validation."""


def curve(run: Path) -> Curve:
    """Read the validation results of a run."""
    rows = [row for row in read_progress(run) if not math.isnan(row["validation_CSR"])]
    return [(row["agent_steps"], row["validation_CSR"], row["validation_ISR"]) for row in rows]


INTRODUCTION = """\
# The report's experiment

`make -f experiments/Makefile reproduction` measures and writes this table; [The report and its
failure](explanation/report.md#what-makes-it-learn) explains it. CSR and ISR are means over three training seeds, with
the minimum and the maximum. Each row changes the row above it, down to `central-ppo`; each of the rows below that
changes `central-ppo` only."""


def write_table(results: dict[str, list[Curve]]) -> None:
    """Write the means and ranges of the last validation over the seeds as Markdown."""
    lines = [*INTRODUCTION.splitlines(), "", "| setting | CSR | ISR |", "| --- | --- | --- |"]
    for name, curves in results.items():
        last = np.array([runs[-1] for runs in curves])
        cells = [f"{last[:, k].mean():.3f} ({last[:, k].min():.2f} to {last[:, k].max():.2f})" for k in (1, 2)]
        lines.append(f"| {name} | {cells[0]} | {cells[1]} |")
    (DOCS / "reproduction.md").write_text("\n".join(lines) + "\n")


def draw_curves(results: dict[str, list[Curve]]) -> None:
    """Plot the means over the seeds: the sequence of changes on the left, changes of `central-ppo` on the right."""
    names = list(results)
    full = names.index("central-ppo")
    columns = {"taken apart, and put together": names[: full + 1], "central-ppo, with one change": names[full:]}
    figure = Figure(figsize=(13, 9), layout="constrained")
    panels = figure.subplots(2, 2, sharex=True, sharey="row")
    for column, (title, chosen) in enumerate(columns.items()):
        for row, label in enumerate(("all agents at their goals (CSR)", "agents at their goals (ISR)")):
            panel = panels[row, column]
            for k, name in enumerate(chosen):
                mean = np.mean(results[name], axis=0)
                style = "-" if k < 10 else "--"  # there are ten colors
                panel.plot(mean[:, 0] / 1e3, mean[:, 1 + row], style, color=f"C{k % 10}", label=name)
            panel.set(ylabel=label if column == 0 else None, ylim=(-0.02, 1.02))
        panels[0, column].set_title(title)
        panels[1, column].set_xlabel("thousand agent steps (4 to an environment step)")
        panels[1, column].legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=2)
    figure.savefig(DOCS / "images" / "reproduction.png", dpi=110)


if __name__ == "__main__":
    main(tyro.cli(Options))
