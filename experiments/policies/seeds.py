"""Train and evaluate the presets of bundled policies with other seeds: `python -m experiments.policies.seeds`.

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

from experiments.pages import FILES
from experiments.policies import imitation
from experiments.study import Study, StudyOptions, folder
from experiments.tables.result_tables import TABLES, ResultTable
from experiments.tables.results import SEEDS, commit, identities, load_results, write
from mapf_pz.evaluation import Episode, evaluate
from mapf_pz.evaluation.reports.report import grouped
from mapf_pz.rl import load_policy
from mapf_pz.rl.config import TrainConfig
from mapf_pz.rl.policies.folder import policy_folder
from mapf_pz.rl.progress import read_progress

IMAGE = FILES / "seeds.png"
VALIDATION = {"oneshot-cardinal": "CSR", "lifelong-cardinal": "throughput"}
"""The metric of validations."""
STUDY = Study(SEEDS, ("preset", "seed", "suite"), ("commit", "task", "num_agents", "policy", "metric", "mean"))
"""The results, of which a suite has several rows."""
CURVES = Study(FILES / "seed-curves.csv", ("preset", "seed"), ("agent_steps", "hours", "value"))
"""The validations during the trainings."""


@dataclass(frozen=True)
class Options(StudyOptions):
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
    if not options.write:
        for seed, preset in itertools.product(options.seeds, options.presets):
            if seed != load_policy(preset).config.seed:
                learn(preset, seed, options)
    draw()
    write()


def learn(preset: str, seed: int, options: Options) -> None:
    """Train a preset with a seed, and evaluate it on the suites without its results, if there are any."""
    names = {table.suite: shielded(table, preset) for table in TABLES if table.suite in options.suites}
    missing = list(STUDY.missing((preset, seed, suite) for suite in names if names[suite]))
    if not missing:
        return
    setting = imitation.bundled(preset)
    run = folder(options.output, f"{preset}-{setting.name}", seed)
    imitation.trained(setting.config, seed, setting.config.agent_steps, run)
    if not same(load_policy(run).config, load_policy(preset).config):
        raise SystemExit(f"{run}: expected the configuration of the bundled policy, apart from the seed")
    add_curve(preset, seed, run)
    for *_, suite in missing:
        named = {name: name.replace(preset, str(run), 1) for name in names[suite]}
        episodes = evaluate(named, suite, run / "evaluation" / suite, options.jobs, overwrite=True)
        STUDY.add((preset, seed, suite), *means(episodes, imitation.METRICS[preset], commit()))


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
    for study in (STUDY, CURVES):
        rows = study.rows()
        others = [row for row in rows if row["preset"] != preset]
        if same(before, now):
            others += [row for row in rows if row["preset"] == preset and row["seed"] != str(now.seed)]
        if len(others) < len(rows):
            study.write(others)


def keep(preset: str, seed: int) -> None:
    """Add the bundled policy's validations and results to those of other seeds."""
    add_curve(preset, seed, policy_folder(preset))
    for table in TABLES:
        if shielded(table, preset):
            STUDY.add((preset, seed, table.suite), *bundled_rows(table, preset))


def bundled_rows(table: ResultTable, preset: str) -> Iterator[dict[str, str]]:
    """Yield the results of the bundled policy in a table, unless they are those of an earlier one."""
    results, now, metric = load_results(table.suite), identities(table).policies, imitation.METRICS[preset]
    for row in results["rows"]:
        name = row["policy"]
        if name in shielded(table, preset) and results["identities"]["policies"][name] == now[name]:
            mean, measured_at = row["metrics"][metric]["mean"], results["measured"][name]["commit"]
            yield mean_row(row["task"], row["num_agents"], name, metric, mean, measured_at)


def add_curve(preset: str, seed: int, run: Path) -> None:
    """Add the validations of a run to those of others, unless they are there."""
    for missing in CURVES.missing([(preset, seed)]):
        CURVES.add(missing, *curve(preset, run))


def curve(preset: str, run: Path) -> Iterator[dict[str, str]]:
    """Yield the validations in the progress of a run."""
    for row in read_progress(run):
        value = row[f"validation_{VALIDATION[preset]}"]
        if not math.isnan(value):
            hours = f"{row['seconds'] / 3600:.3f}"
            yield {"agent_steps": f"{row['agent_steps']:.0f}", "hours": hours, "value": f"{value:.6g}"}


def draw() -> None:
    """Plot the validations of the bundled policies and of the other seeds."""
    figure = Figure(figsize=(10, 3.6), layout="constrained")
    for panel, preset in zip(figure.subplots(1, len(VALIDATION)), VALIDATION, strict=True):
        curves = {str(load_policy(preset).config.seed): list(curve(preset, policy_folder(preset)))}
        for row in CURVES.rows():
            if row["preset"] == preset:
                curves.setdefault(row["seed"], []).append(row)
        for seed in sorted(curves):
            points = [(int(row["agent_steps"]) / 1e6, float(row["value"])) for row in curves[seed]]
            panel.plot(*zip(*points, strict=True), label=f"seed {seed}")
        panel.set(title=preset, xlabel="million agent steps", ylabel=f"{VALIDATION[preset]} of validations", ylim=0)
        panel.legend()
    figure.savefig(IMAGE, dpi=90)


def shielded(table: ResultTable, preset: str) -> list[str]:
    """Return the policies of a table that are the bundled policy of a preset, without the safety layer and with it."""
    return [name for name in table.policies if name.partition("+")[0] == preset]


def means(episodes: Sequence[Episode], metric: str, measured_at: str) -> Iterator[dict[str, str]]:
    """Yield the mean of each policy in each task, measured at a commit."""
    for (task, num_agents, policy), values in grouped(episodes).items():
        yield mean_row(task, num_agents, policy, metric, float(np.mean(values[metric])), measured_at)


def mean_row(task: str, num_agents: int, policy: str, metric: str, mean: float, measured_at: str) -> dict[str, str]:
    """Return the mean of a policy in a task as a row; of the commit that measured it, the first seven characters."""
    values = (measured_at[:7], task, str(num_agents), policy, metric, f"{mean:.6g}")
    return dict(zip(STUDY.measures, values, strict=True))


if __name__ == "__main__":
    main(tyro.cli(Options))
