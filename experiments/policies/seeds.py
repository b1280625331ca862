"""Train and evaluate the presets of bundled policies with other seeds: `python -m experiments.policies.seeds`.

The bundled policy is one training run of its preset; those with other seeds show how much its results depend on the
seed. They are evaluated as the bundled policy is in the result tables: on the same suites, without the safety layer and
with it. `docs/results/seeds.csv` gets the results, which are not repeated then, `docs/results/seed-curves.csv` the
validations during training, and the pages the tables and a figure. Runs that were stopped go on.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro
from matplotlib.figure import Figure

from experiments.pages import key_of, read_rows, write_rows
from experiments.policies import imitation
from experiments.report.published import folder
from experiments.tables.result_tables import TABLES, ResultTable
from experiments.tables.results import FILES, SEEDS, commit, identities, load_results, write
from mapf_pz.evaluation import Episode, evaluate
from mapf_pz.evaluation.reports.report import grouped
from mapf_pz.rl import load_policy
from mapf_pz.rl.config import TrainConfig
from mapf_pz.rl.policies.folder import policy_folder
from mapf_pz.rl.presets import PRESETS
from mapf_pz.rl.progress import read_progress

CURVES, IMAGE = FILES / "seed-curves.csv", FILES / "seeds.png"
VALIDATION = {"oneshot-cardinal": "CSR", "lifelong-cardinal": "throughput"}
"""The metric of validations."""
KEY = ("preset", "seed", "suite")
"""Columns that determine an evaluation."""
RESULTS = (*KEY, "commit", "task", "num_agents", "policy", "metric", "mean")
"""Columns of the results."""


@dataclass(frozen=True)
class Options:
    """Options of the experiment."""

    output: Path = imitation.Options.output
    """Folder of all runs, which are also those of `experiments.policies.imitation`."""
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
        tables = list(missing(preset, seed, options.suites))
        if seed == bundled.seed or not tables:
            continue
        run = folder(options.output, f"{preset}-{imitation.BUNDLED}", seed)
        imitation.trained(PRESETS[preset], seed, PRESETS[preset].agent_steps, run)
        if not same(load_policy(run).config, bundled):
            raise SystemExit(f"{run}: expected the configuration of the bundled policy, apart from the seed")
        add_curve(preset, seed, run)
        for table in tables:
            named = {name: name.replace(preset, str(run), 1) for name in shielded(table, preset)}
            episodes = evaluate(named, table.suite, run / "evaluation" / table.suite, options.jobs, overwrite=True)
            of_run = origin(preset, seed, table.suite, commit())
            add([of_run | row for row in means(episodes, imitation.METRICS[preset])])
    draw()
    write()


def missing(preset: str, seed: int, suites: Sequence[str]) -> Iterator[ResultTable]:
    """Yield the tables with the policy of a preset and one of these suites, in which the seed is not measured."""
    found = {key_of(row, KEY) for row in read_rows(SEEDS)}
    for table in TABLES:
        if table.suite in suites and shielded(table, preset) and (preset, str(seed), table.suite) not in found:
            yield table


def same(config: TrainConfig, other: TrainConfig) -> bool:
    """Return whether two configurations are the same, apart from the seed."""
    return replace(config, seed=other.seed) == other


def before_bundling(preset: str, now: TrainConfig) -> None:
    """Update the results of other seeds before a policy with the configuration `now` replaces that of a preset.

    If only their seeds differ, the results of the present policy are kept beside the others, and those with the new
    policy's seed are removed; if more differs, all are removed.
    """
    before = load_policy(preset).config
    if same(before, now) and before.seed != now.seed:
        keep(preset, before.seed)
    for file in (SEEDS, CURVES):
        rows = read_rows(file)
        others = [row for row in rows if row["preset"] != preset]
        if same(before, now):
            others += [row for row in rows if row["preset"] == preset and row["seed"] != str(now.seed)]
        if len(others) < len(rows):
            write_rows(file, others, list(rows[0]))


def keep(preset: str, seed: int) -> None:
    """Add the bundled policy's validations and results to those of other seeds."""
    add_curve(preset, seed, policy_folder(preset))
    add([row for table in TABLES if shielded(table, preset) for row in bundled_rows(table, preset, seed)])


def add(rows: Sequence[Mapping[str, str]]) -> None:
    """Add results."""
    write_rows(SEEDS, sorted([*read_rows(SEEDS), *rows], key=lambda row: key_of(row, KEY)), RESULTS)


def bundled_rows(table: ResultTable, preset: str, seed: int) -> Iterator[dict[str, str]]:
    """Yield the results of the bundled policy in a table, unless they are those of an earlier one."""
    results, now, metric = load_results(table.suite), identities(table).policies, imitation.METRICS[preset]
    for row in results["rows"]:
        name = row["policy"]
        if name in shielded(table, preset) and results["identities"]["policies"][name] == now[name]:
            of_run = origin(preset, seed, table.suite, results["measured"][name]["commit"])
            yield of_run | mean_row(row["task"], row["num_agents"], name, metric, row["metrics"][metric]["mean"])


def origin(preset: str, seed: int, suite: str, measured_at: str) -> dict[str, str]:
    """Return the first columns of a result: the run, the suite, and the commit that measured it, shortened."""
    return {"preset": preset, "seed": str(seed), "suite": suite, "commit": measured_at[:7]}


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
        yield mean_row(task, num_agents, policy, metric, float(np.mean(values[metric])))


def mean_row(task: str, num_agents: int, policy: str, metric: str, mean: float) -> dict[str, str]:
    """Return the mean of a policy in a task as a row."""
    row = {"task": task, "num_agents": num_agents, "policy": policy, "metric": metric, "mean": f"{mean:.6g}"}
    return {name: str(value) for name, value in row.items()}


if __name__ == "__main__":
    main(tyro.cli(Options))
