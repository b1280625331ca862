"""The experiment of the report's authors, as published and with repairs: `make long RUN=report-runs`.

`run` trains with `examples/report_published.py`: each setting with three seeds. Stopped runs go on. `collect` adds the
evaluations of complete runs to `docs/results/report-runs.csv`, whose runs are not repeated. From this file, `write`
makes the table in `docs/explanation/report.md` and the figure, with the curves of the authors' own runs beside.
"""

from __future__ import annotations

import itertools
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import tyro
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.report_page import read_rows, spread, write_rows, write_table

ROOT = Path(__file__).parents[1]
EXAMPLE = ROOT / "examples" / "report_published.py"
CURVES = ROOT / "docs" / "results" / "report-runs.csv"
IMAGE = ROOT / "docs" / "images" / "report-runs.png"

SETTINGS: dict[str, tuple[str, ...]] = {
    "as published": (),
    "finished agents act again": ("--repair", "finished"),
    "actions from weights": ("--actions", "weights"),
    "all repaired": ("--repair", "all"),
    "all repaired, weights": ("--repair", "all", "--actions", "weights"),
    "all repaired, weights, blocked moves pay": ("--repair", "all", "--keep", "blocked", "--actions", "weights"),
    "float observations": ("--repair", "bytes"),
    "channels first": ("--repair", "transposed"),
    "turns at the border": ("--repair", "border"),
    "counts are no cells": ("--repair", "header"),
    "map as in its file": ("--repair", "flipped"),
    "stations are free": ("--repair", "stations"),
    "own goals only": ("--repair", "any_goal"),
    "blocked moves pay nothing": ("--repair", "blocked"),
    "no occlusion": ("--repair", "occluded"),
    "normal noise": ("--no-gsde",),
    "no dropout": ("--dropout", "0"),
}
"""Settings and the options of the example."""

LENGTH = 500_000
"""Length of a run in environment steps."""

Rows = Sequence[Mapping[str, str]]


def run(
    settings: tuple[str, ...] = tuple(SETTINGS),
    seeds: tuple[int, ...] = (0, 1, 2),
    steps: int = LENGTH,
    jobs: int = 1,
    output: Path = Path("runs/report-runs"),
) -> None:
    """Train the runs that are not in `docs/results/report-runs.csv` yet: 20 minutes of a core each.

    Args:
        settings: names of settings. Default: all.
        seeds: random seeds.
        steps: length of training in environment steps. Shorter runs that exist are continued.
        jobs: number of processes.
        output: folder of all runs.
    """
    if unknown := set(settings) - set(SETTINGS):
        raise SystemExit(f"settings {', '.join(sorted(unknown))}: expected some of {', '.join(SETTINGS)}")

    def train(name: str, seed: int) -> None:
        where = folder(output, name, seed)
        where.mkdir(parents=True, exist_ok=True)
        command = [sys.executable, EXAMPLE, *SETTINGS[name], f"--seed={seed}", f"--steps={steps}", f"--output={where}"]
        with (where / "output.txt").open("a") as told:
            subprocess.run(command, check=True, stdout=told, stderr=subprocess.STDOUT)
        print(f"{name}, seed {seed}: done", flush=True)

    known = _complete(read_rows(CURVES), steps)
    missing = [(name, seed) for name in settings for seed in seeds if (name, str(seed)) not in known]
    with ThreadPoolExecutor(jobs) as pool:
        for done in [pool.submit(train, name, seed) for name, seed in missing]:
            done.result()


def folder(output: Path, name: str, seed: int) -> Path:
    """Return the folder of a run."""
    return output / f"{name.replace(',', '').replace(' ', '-')}-{seed}"


def collect(output: Path = Path("runs/report-runs")) -> None:
    """Add the evaluations of all complete runs to those of earlier ones, and write the table.

    Args:
        output: folder of all runs.
    """
    runs = _complete(read_rows(CURVES), LENGTH)
    for name, seed in itertools.product(SETTINGS, range(3)):
        path = folder(output, name, seed) / "curve.csv"
        runs |= _complete([{"setting": name, "seed": str(seed)} | row for row in read_rows(path)], LENGTH)
    rows = [row for name in SETTINGS for run, curve in runs.items() if run[0] == name for row in curve]
    write_rows(CURVES, [row | {key: f"{float(row[key]):.2f}" for key in row if "reward" in key} for row in rows])
    write()


def _complete(rows: Rows, steps: int) -> dict[tuple[str, str], list[dict[str, str]]]:
    """Return the evaluations of each setting and seed that was trained for `steps` environment steps or more."""
    runs: dict[tuple[str, str], list[dict[str, str]]] = {}
    for row in rows:
        runs.setdefault((row["setting"], row["seed"]), []).append(dict(row))
    return {run: curve for run, curve in runs.items() if float(curve[-1]["env_steps"]) >= steps}


def write(authors: Path | None = None) -> None:
    """Write the table, and draw the figure if there are the authors' curves.

    Args:
        authors: file of the authors' evaluations, with columns `run`, `env_steps` and `mean_reward`.
    """
    runs = read_runs()
    write_table("report runs", table(runs))
    if authors is not None:
        draw(runs, read_rows(authors))


Runs = Mapping[str, Sequence[np.ndarray]]
"""Of each setting, the evaluations of each seed (T, 7): see `COLUMNS` of the example."""


def read_runs() -> Runs:
    """Return the evaluations of `docs/results/report-runs.csv`, cut to the length of the setting's shortest run."""
    seeds: dict[tuple[str, str], list[list[float]]] = {}
    for row in read_rows(CURVES):
        name, seed, *values = row.values()
        seeds.setdefault((name, seed), []).append([float(value) for value in values])
    runs: dict[str, list[np.ndarray]] = {}
    for (name, _), values in seeds.items():
        runs.setdefault(name, []).append(np.array(values))
    return {name: [curve[: min(map(len, curves))] for curve in curves] for name, curves in runs.items()}


def table(runs: Runs) -> Iterator[str]:
    """Yield the first and the last evaluation of each setting as Markdown: means over seeds, minimum and maximum."""
    yield "| setting | seeds | steps | reward | finished | reward, new environments | finished there |"
    yield "| --- | --- | --- | --- | --- | --- | --- |"
    for name, curves in runs.items():
        first, last = (np.array([curve[k] for curve in curves]) for k in (0, -1))
        cells = [
            f"{len(curves)}",
            f"{last[0, 0]:,.0f}",
            f"{first[:, 1].mean():.0f} → {spread(last[:, 1], 0)}",
            spread(last[:, 4], 1),
            f"{first[:, 5].mean():.0f} → {spread(last[:, 5], 0)}",
            f"{first[:, 6].mean():.1f} → {spread(last[:, 6], 1)}",
        ]
        yield f"| {name} | {' | '.join(cells)} |"


def draw(runs: Runs, authors: Rows) -> None:
    """Plot the reward of evaluations, the authors' and ours, and that in new environments."""
    figure = Figure(figsize=(13, 4.5), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    for k, name in enumerate(("ppo/11", "ppo/21", "ppo/23", "2nd-machine/1")):
        points = [(float(row["env_steps"]), float(row["mean_reward"])) for row in authors if row["run"] == name]
        steps, rewards = np.array(points).T
        left.plot(steps / 1000, rewards, color=f"C{k}", linewidth=1, label=f"authors' {name}")
    _draw_range(left, runs["as published"], 1, "ours, as published", "black")
    left.set(ylabel="reward of an episode, sum over agents", title="the environment of evaluations", xlim=(0, 1000))
    for k, name in enumerate(("as published", "finished agents act again", "actions from weights", "all repaired")):
        if name in runs:
            _draw_range(right, runs[name], 5, f"ours, {name}", "black" if k == 0 else f"C{k + 4}")
    right.set(title="new environments", xlim=(0, 500))
    for panel in (left, right):
        panel.set_xlabel("thousand environment steps")
        panel.legend(fontsize=8)
    figure.savefig(IMAGE, dpi=90)


def _draw_range(axes: Axes, curves: Sequence[np.ndarray], column: int, label: str, color: str) -> None:
    """Plot the mean and the range of a column over seeds."""
    steps, values = curves[0][:, 0] / 1000, np.stack([curve[:, column] for curve in curves])
    axes.plot(steps, values.mean(0), color=color, linewidth=2, label=label)
    axes.fill_between(steps, values.min(0), values.max(0), color=color, alpha=0.2, linewidth=0)


if __name__ == "__main__":
    tyro.extras.subcommand_cli_from_dict({"run": run, "collect": collect, "write": write})
