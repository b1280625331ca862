"""Train and evaluate the presets of bundled policies with other seeds: `python -m experiments.seeds`.

The bundled policy is one training run of its preset; those with other seeds show how much its results depend on the
seed. They are evaluated as the bundled policy is in the result tables: on the same suites, without the safety layer and
with it. `docs/results/seeds.csv` gets the results, which are not repeated then, `docs/results/seed-curves.csv` the
validations during training, and the pages the tables and a figure. Runs that were stopped go on.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro
from matplotlib.figure import Figure

from experiments import imitation
from experiments.pages import key_of, read_rows, write_rows
from experiments.report_runs import folder
from experiments.results import FILES, SEEDS, commit, write
from experiments.tables import TABLES, ResultTable
from mapf_pz.evaluation import Episode, evaluate
from mapf_pz.evaluation.reports.report import grouped
from mapf_pz.rl import load_policy
from mapf_pz.rl.config import TrainConfig
from mapf_pz.rl.policies.folder import policy_folder
from mapf_pz.rl.presets import PRESETS
from mapf_pz.rl.training.progress import read_progress

CURVES, IMAGE = FILES / "seed-curves.csv", FILES / "seeds.png"
VALIDATION = {"oneshot-cardinal": "CSR", "lifelong-cardinal": "throughput"}
"""The metric of validations."""
KEY = ("preset", "seed", "suite")
"""Columns that determine an evaluation."""


@dataclass(frozen=True)
class Options:
    """Options of the experiment."""

    output: Path = imitation.Options.output
    """Folder of all runs, which are also those of `experiments.imitation`."""
    presets: tuple[str, ...] = ("oneshot-cardinal", "lifelong-cardinal")
    """The presets."""
    seeds: tuple[int, ...] = (0, 1, 2)
    """Random seeds. That of the bundled policy is skipped."""
    suites: tuple[str, ...] = tuple(table.suite for table in TABLES)
    """Suites. Those whose tables do not have the policy are skipped."""
    jobs: int = 1
    """Number of processes of an evaluation."""


def main(options: Options) -> None:
    """Train and evaluate the missing runs in sequence; write results after each suite, and the tables at the end."""
    for seed, preset in itertools.product(options.seeds, options.presets):
        bundled = load_policy(preset).config
        if seed == bundled.seed:
            continue
        run = folder(options.output, f"{preset}-{imitation.BUNDLED}", seed)
        imitation.trained(PRESETS[preset], seed, PRESETS[preset].agent_steps, run)
        if not same(load_policy(run).config, bundled):
            raise SystemExit(f"{run}: expected the configuration of the bundled policy, apart from the seed")
        add_curve(preset, seed, run)
        for table in TABLES:
            policies = shielded(table, preset)
            key = (preset, str(seed), table.suite)
            found = read_rows(SEEDS)
            if not policies or table.suite not in options.suites or key in [key_of(row, KEY) for row in found]:
                continue
            named = {name: name.replace(preset, str(run), 1) for name in policies}
            episodes = evaluate(named, table.suite, run / "evaluation" / table.suite, options.jobs, overwrite=True)
            origin = dict(zip(KEY, key, strict=True)) | {"commit": commit()[:7]}
            found += [origin | row for row in means(episodes, imitation.METRICS[preset])]
            write_rows(SEEDS, sorted(found, key=lambda row: key_of(row, KEY)))
    draw()
    write()


def same(config: TrainConfig, other: TrainConfig) -> bool:
    """Return whether two configurations are the same, apart from the seed."""
    return replace(config, seed=other.seed) == other


def forget(preset: str, before: TrainConfig, now: TrainConfig) -> None:
    """Remove the results that no longer belong beside those of the bundled policy of a preset, which is replaced.

    Those are all if its configuration is another one, else those with its seed.
    """
    for file in (SEEDS, CURVES):
        rows = read_rows(file)
        others = [row for row in rows if row["preset"] != preset]
        if same(before, now):
            others += [row for row in rows if row["preset"] == preset and row["seed"] != str(now.seed)]
        if len(others) < len(rows):
            write_rows(file, others, list(rows[0]))


def add_curve(preset: str, seed: int, run: Path) -> None:
    """Add the validations of a run to those of others, unless they are there."""
    rows = read_rows(CURVES)
    if (preset, str(seed)) not in [key_of(row, KEY[:2]) for row in rows]:
        write_rows(CURVES, sorted([*rows, *curve(preset, seed, run)], key=lambda row: key_of(row, KEY[:2])))


def curve(preset: str, seed: int, run: Path) -> Iterator[dict[str, str]]:
    """Yield the validations in the progress of a run."""
    for row in read_progress(run):
        value = row[f"validation_{VALIDATION[preset]}"]
        if not math.isnan(value):
            hours = f"{row['seconds'] / 3600:.3f}"
            steps = f"{row['agent_steps']:.0f}"
            yield {"preset": preset, "seed": f"{seed}", "agent_steps": steps, "hours": hours, "value": f"{value:.6g}"}


def draw() -> None:
    """Plot the validations of the bundled policies and of the other seeds."""
    figure = Figure(figsize=(10, 3.6), layout="constrained")
    for panel, preset in zip(figure.subplots(1, len(VALIDATION)), VALIDATION, strict=True):
        bundled = policy_folder(preset)
        rows = [*curve(preset, load_policy(preset).config.seed, bundled), *read_rows(CURVES)]
        rows = [row for row in rows if row["preset"] == preset]
        for seed in sorted({row["seed"] for row in rows}):
            points = [(int(row["agent_steps"]) / 1e6, float(row["value"])) for row in rows if row["seed"] == seed]
            panel.plot(*zip(*points, strict=True), label=f"seed {seed}")
        panel.set(title=preset, xlabel="million agent steps", ylabel=f"{VALIDATION[preset]} of validations", ylim=0)
        panel.legend()
    figure.savefig(IMAGE, dpi=90)


def shielded(table: ResultTable, preset: str) -> list[str]:
    """Return the policies of a table that are the bundled policy of a preset, without the safety layer and with it."""
    return [name for name in table.policies if name.partition("+")[0] == preset]


def means(episodes: Sequence[Episode], metric: str) -> Iterator[dict[str, str]]:
    """Yield the mean of each policy in each task."""
    for (task, num_agents, policy), values in grouped(episodes).items():
        numbers = values[metric]
        yield {
            "task": task,
            "num_agents": str(num_agents),
            "policy": policy,
            "metric": metric,
            "mean": f"{np.mean(numbers):.6g}",
        }


if __name__ == "__main__":
    main(tyro.cli(Options))
