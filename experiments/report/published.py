"""The experiment of the report's authors, as published and with repairs: `make -f experiments/Makefile report-runs`.

`run` trains with `examples/report_published.py`: each setting with its seeds. Stopped runs go on. `collect` adds the
evaluations of complete runs to `docs/results/report-runs.csv`, whose runs are not repeated. From this file, `write`
makes the tables in `docs/explanation/report-runs.md` and the figure, with the curves of the authors' own runs beside.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.pages import FILES, PAGES, read_rows, spread, write_rows, write_table
from experiments.study import check_known, folder

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples" / "report_published.py"
CURVES, PAGE = FILES / "report-runs.csv", PAGES / "report-runs.md"
IMAGE = ROOT / "docs" / "images" / "report-runs.png"


@dataclass(frozen=True)
class Setting:
    """What is trained, and for how long."""

    options: tuple[str, ...] = ()
    """Options of the example."""
    steps: int = 500_000
    """Length of a run in environment steps."""
    seeds: tuple[int, ...] = (0, 1, 2)
    """Random seeds, one run each."""


SHORT = 100_000
"""Length of the runs in which a single difference is measured only, in environment steps."""
DIFFERENCES: dict[str, Setting] = {
    "finished agents act again": Setting(("--repair", "finished")),
    "actions from weights": Setting(("--actions", "weights")),
    "float observations": Setting(("--repair", "bytes"), SHORT),
    "channels first": Setting(("--repair", "transposed"), SHORT),
    "turns at the border": Setting(("--repair", "border"), SHORT),
    "counts are no cells": Setting(("--repair", "header"), SHORT),
    "map as in its file": Setting(("--repair", "flipped"), SHORT),
    "stations are free": Setting(("--repair", "stations"), SHORT),
    "own goals only": Setting(("--repair", "any_goal"), SHORT),
    "blocked moves pay nothing": Setting(("--repair", "blocked"), SHORT),
    "no occlusion": Setting(("--repair", "occluded"), SHORT),
    "normal noise": Setting(("--no-gsde",), SHORT),
    "no dropout": Setting(("--dropout", "0"), SHORT),
}
"""The runs that differ from the published ones in one thing."""

TEXT = ("--repair", "all", "--actions", "weights")
SETTINGS: dict[str, Setting] = {
    "as published": Setting(),
    "as published, longer": Setting(steps=2_000_000, seeds=(0,)),
    **DIFFERENCES,
    "all repaired": Setting(("--repair", "all")),
    "all repaired, weights": Setting(TEXT),
    "all repaired, weights, blocked moves pay": Setting((*TEXT, "--keep", "blocked")),
}
"""All runs."""

Rows = Sequence[Mapping[str, str]]


def run(settings: tuple[str, ...] = tuple(SETTINGS), jobs: int = 1, output: Path = Path("runs/report-runs")) -> None:
    """Train the runs that are not in `docs/results/report-runs.csv` yet: 500,000 steps take 20 to 30 minutes of a core.

    Args:
        settings: names of settings. Default: all.
        jobs: number of processes.
        output: folder of all runs.
    """
    check_known("settings", settings, tuple(SETTINGS))

    def train(name: str, seed: int) -> None:
        where = folder(output, name, seed)
        where.mkdir(parents=True, exist_ok=True)
        options = (*SETTINGS[name].options, f"--seed={seed}", f"--steps={SETTINGS[name].steps}", f"--output={where}")
        with (where / "output.txt").open("a") as told:
            subprocess.run([sys.executable, EXAMPLE, *options], check=True, stdout=told, stderr=subprocess.STDOUT)
        print(f"{name}, seed {seed}: done", flush=True)

    known = _complete(read_rows(CURVES))
    missing = [(name, seed) for name, seed in _planned() if name in settings and (name, str(seed)) not in known]
    with ThreadPoolExecutor(jobs) as pool:
        for done in [pool.submit(train, name, seed) for name, seed in missing]:
            done.result()


def _planned() -> Iterator[tuple[str, int]]:
    """Yield the setting and the seed of each run; all settings with a first seed come before those with a second."""
    order = sorted((seed, k, name) for k, (name, setting) in enumerate(SETTINGS.items()) for seed in setting.seeds)
    return ((name, seed) for seed, _, name in order)


def collect(output: Path = Path("runs/report-runs")) -> None:
    """Add the evaluations of all complete runs to those of earlier ones, and write the table.

    Args:
        output: folder of all runs.
    """
    runs = _complete(read_rows(CURVES))
    for name, seed in _planned():
        path = folder(output, name, seed) / "curve.csv"
        runs |= _complete([{"setting": name, "seed": str(seed)} | row for row in read_rows(path)])
    rows = [row for name in SETTINGS for run, curve in sorted(runs.items()) if run[0] == name for row in curve]
    rounded = [row | {key: f"{float(row[key]):.2f}" for key in row if "reward" in key} for row in rows]
    write_rows(CURVES, rounded, list(rows[0]))
    write()


def _complete(rows: Rows) -> dict[tuple[str, str], list[dict[str, str]]]:
    """Return the evaluations of each setting and seed whose run has its whole length."""
    runs: dict[tuple[str, str], list[dict[str, str]]] = {}
    for row in rows:
        runs.setdefault((row["setting"], row["seed"]), []).append(dict(row))
    return {run: curve for run, curve in runs.items() if float(curve[-1]["env_steps"]) >= SETTINGS[run[0]].steps}


def write(authors: Path | None = None) -> None:
    """Write the table, and draw the figure if there are the authors' curves.

    Args:
        authors: file of the authors' evaluations, with columns `run`, `env_steps` and `mean_reward`.
    """
    runs = read_runs()
    write_table(PAGE, "report runs", table({name: runs[name] for name in runs if SETTINGS[name].steps > SHORT}))
    write_table(PAGE, "single differences", table(single_differences(runs)))
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


def single_differences(runs: Runs) -> Runs:
    """Return the first `SHORT` environment steps of the published runs, and of those that differ in one thing."""
    names = [name for name in runs if name in ("as published", *DIFFERENCES)]
    return {name: [curve[: np.searchsorted(curve[:, 0], SHORT) + 1] for curve in runs[name]] for name in names}


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
    draw_authors(left, authors)
    _draw_range(left, runs["as published"], 1, "ours, as published", "black")
    _draw_range(left, runs["as published, longer"], 1, "ours, as published, longer", "gray")
    left.set(ylabel="reward of an episode, sum over agents", title="the environment of evaluations")
    colors = {"as published": "black", "as published, longer": "gray"}
    for k, name in enumerate((*colors, "finished agents act again", "actions from weights", "all repaired")):
        _draw_range(right, runs[name], 5, f"ours, {name}", colors.get(name, f"C{k + 2}"))
    right.set(title="new environments")
    for panel in (left, right):
        panel.set(xlabel="thousand environment steps", xlim=(0, 2010))
        panel.legend(fontsize=8)
    figure.savefig(IMAGE, dpi=90)


def draw_authors(axes: Axes, authors: Rows) -> None:
    """Plot the rewards of the authors' longest runs."""
    for k, name in enumerate(("ppo/11", "ppo/21", "ppo/23", "2nd-machine/1")):
        points = [(float(row["env_steps"]), float(row["mean_reward"])) for row in authors if row["run"] == name]
        steps, rewards = np.array(points).T
        axes.plot(steps / 1000, rewards, color=f"C{k}", linewidth=1, label=f"authors' {name}")


def _draw_range(axes: Axes, curves: Sequence[np.ndarray], column: int, label: str, color: str) -> None:
    """Plot the mean and the range of a column over seeds."""
    steps, values = curves[0][:, 0] / 1000, np.stack([curve[:, column] for curve in curves])
    axes.plot(steps, values.mean(0), color=color, linewidth=2, label=label)
    axes.fill_between(steps, values.min(0), values.max(0), color=color, alpha=0.2, linewidth=0)


if __name__ == "__main__":
    tyro.extras.subcommand_cli_from_dict({"run": run, "collect": collect, "write": write})
