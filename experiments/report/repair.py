"""What the report's policy lacked: `python -m experiments.report.repair`.

The preset `report-repaired` routes its agents, and the preset `report` does not. The settings between them are those of
`report-repaired` with one change taken back, and those of `report` with one change made. Each is trained with three
seeds; runs that were stopped go on. `docs/results/repair.csv` gets the last validation of each run, which is not
repeated then, and `docs/explanation/report.md` the table.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from matplotlib.figure import Figure

from experiments.pages import FILES, PAGES, read_rows, spread, write_table
from experiments.report.published import Rows, draw_authors
from experiments.report.reproduction import Variation, curve
from experiments.study import Study, StudyOptions
from mapf_pz.rl.presets import PRESETS
from mapf_pz.rl.training.checkpoint import Checkpoints
from mapf_pz.rl.training.train import resume, train

PAGE = PAGES / "report.md"
IMAGE = Path(__file__).parents[2] / "docs" / "images" / "repair.png"
NUM_AGENTS = 10
"""The number of agents, with which one environment step is as many agent steps."""
STUDY = Study(FILES / "repair.csv", ("setting", "seed"), ("agent_steps", "CSR", "ISR"))
PARTS = ("env", "model", "optimization", "ppo")
CHANGES: dict[str, tuple[str, ...]] = {
    "cost to go (idea 2)": ("cost_to_go", "others_next", "action_advantage"),
    "cost to go around agents at their goals": ("around_agents_at_goals",),
    "goal and own location (idea 3)": ("goal_vector", "location"),
    "past actions (idea 5)": ("last_actions",),
    "which agents are at their goals": ("others_at_goal",),
    "centered view": ("view",),
    "optimized edge weights (idea 1)": ("edge_weights",),
    "reward for progress": ("reward",),
    "an advantage for each agent": ("credit",),
    "a discount factor of 0.9": ("gamma", "lmbda"),
    "more and smaller minibatches": ("num_envs", "minibatch_size"),
    "a higher learning rate": ("learning_rate",),
    "smaller gradients": ("max_grad_norm",),
    "GELU": ("activation",),
    "an entropy bonus": ("entropy_coeff",),
}
"""The differences between the presets: fields of the configuration, or channels and features."""


@dataclass(frozen=True)
class Options(StudyOptions):
    """Options of the experiment."""

    output: Path = Path("runs/repair")
    """Folder of all runs."""
    seeds: tuple[int, ...] = (0, 1, 2)
    """Random seeds."""
    agent_steps: int = 500_000
    """Length of each training."""
    authors: Path | None = None
    """File of the authors' evaluations, with columns `run`, `env_steps` and `mean_reward`, for the figure. None: it is
    not drawn."""


def settings() -> Iterator[Variation]:
    """Yield the settings: both presets, and those between them."""
    full, bare = (Variation(name, PRESETS[name]) for name in ("report-repaired", "report"))
    bare = bare.with_(bare.name, env={"max_steps": full.config.task.env.max_steps})
    # The report's random sampling of actions is the only difference that is not between the presets.
    sampled = full.with_("report-repaired, actions sampled", task={"action_mode": "affine"})
    yield from (full, sampled)
    yield from (changed(full, f"report-repaired without {name}", bare, fields) for name, fields in CHANGES.items())
    yield bare
    yield from (changed(bare, f"report with {name}", full, fields) for name, fields in CHANGES.items())


def changed(setting: Variation, name: str, other: Variation, fields: tuple[str, ...]) -> Variation:
    """Return a setting with the values of another one in some fields; channels and features are added or removed."""
    changes: dict[str, dict[str, Any]] = {}
    for part in PARTS:
        mine, theirs = (vars(_part(one, part)) for one in (setting, other))
        taken = {field: theirs[field] for field in fields if field in theirs}
        for kind in ("channels", "features") if part == "env" else ():
            named = set(fields) - mine.keys()
            either = dict.fromkeys((*theirs[kind], *mine[kind]))
            taken[kind] = tuple(one for one in either if one in (theirs if one in named else mine)[kind])
        changes[part] = taken
    return setting.with_(name, None, **changes)


def _part(setting: Variation, part: str) -> Any:
    config = setting.config
    return config.task.env if part == "env" else getattr(config, part)


def learn(setting: Variation, seed: int, options: Options) -> list[Mapping[str, str]]:
    """Train a setting, unless its run is finished, and return its validations."""
    name = "".join(char if char.isalnum() else "-" for char in setting.name)
    output = options.output / f"{name}-{seed}"
    if not any(Checkpoints(output).folder.glob("*")):  # a run that was killed before the first one begins again
        interval = options.agent_steps // 5
        steps = {"agent_steps": options.agent_steps, "validation_interval": interval, "validation_episodes": 64}
        train(replace(setting.config, seed=seed, **steps), output, overwrite=True)
    elif curve(output)[-1][0] < options.agent_steps:
        resume(output)
    return [
        {"agent_steps": f"{steps:.0f}", "CSR": f"{solved:.4f}", "ISR": f"{arrived:.4f}"}
        for steps, solved, arrived in curve(output)
    ]


def write() -> None:
    """Write the table from the results: of each run the last validation.

    Changes are sorted by the ISR without them; those without results are omitted, and so is a column without any.
    """
    last = {(row["setting"], row["seed"]): row for row in STUDY.rows()}
    found: dict[str, list[Mapping[str, str]]] = {}
    for (setting, _), row in last.items():
        found.setdefault(setting, []).append(row)

    def cells(name: str) -> str:
        values = {metric: np.array([float(row[metric]) for row in found.get(name, [])]) for metric in ("CSR", "ISR")}
        return " | ".join(spread(each, 2) if len(each) else "" for each in values.values())

    def mean_isr(name: str) -> float:
        values = [float(row["ISR"]) for row in found.get(f"report-repaired without {name}", [])]
        return float(np.mean(values)) if values else np.inf

    changes = sorted(CHANGES, key=mean_isr)
    sampled = "report-repaired, actions sampled"
    rows = {"all of it": ("report-repaired", "report"), "the most likely action instead of a sample": (sampled, "")}
    rows |= {name: (f"report-repaired without {name}", f"report with {name}") for name in changes}
    alone = any(name in found for _, name in rows.values())
    lines = ["| change | taken back: CSR | ISR |" + (" made alone: CSR | ISR |" if alone else "")]
    lines += ["| --- | --- | --- |" + (" --- | --- |" if alone else "")]
    lines += [
        f"| {name} | {cells(without)} |" + (f" {cells(single)} |" if alone else "")
        for name, (without, single) in rows.items()
        if without in found or single in found
    ]
    write_table(PAGE, "repair", lines)


def draw(authors: Rows) -> None:
    """Draw the rewards of the authors' runs, and the share of agents at their goals in those of this experiment."""
    figure = Figure(figsize=(15, 4.5), layout="constrained")
    left, right = figure.subplots(1, 2)
    draw_authors(left, authors)
    left.set(ylabel="reward of an episode, sum over agents", title="the report's policy, the authors' runs")
    for k, (name, curves) in enumerate(_arrived().items()):
        color, width = ("black", 3.0) if k == 0 else (f"C{k % 10}", 1.5)
        steps = curves[0][:, 0]
        values = np.mean([np.interp(steps, *curve.T) for curve in curves], axis=0)
        right.plot(
            steps / NUM_AGENTS / 1000, values, "-" if k <= 10 else "--", color=color, linewidth=width, label=name
        )
    right.set(ylabel="share of agents at their goals (ISR)", title="report-repaired, and with a change taken back")
    for panel in (left, right):
        panel.set(xlabel="thousand environment steps")
    left.legend(fontsize=8)
    figure.legend(*right.get_legend_handles_labels(), loc="outside right center", fontsize=8)
    figure.savefig(IMAGE, dpi=80)


def _arrived() -> dict[str, list[np.ndarray]]:
    """Return the validations of `report-repaired` and of each change taken back: a curve (T, 2) of each seed.

    The columns are agent steps and ISR.
    """
    curves: dict[tuple[str, str], list[tuple[float, float]]] = {}
    for row in STUDY.rows():
        curves.setdefault((row["setting"], row["seed"]), []).append((float(row["agent_steps"]), float(row["ISR"])))
    settings = {"all of it": "report-repaired", "sampled actions": "report-repaired, actions sampled"}
    settings |= {f"without {name}": f"report-repaired without {name}" for name in CHANGES}
    found = {
        label: [np.array(curve) for (setting, _), curve in curves.items() if setting == name]
        for label, name in settings.items()
    }
    return {label: runs for label, runs in found.items() if runs}


def main(options: Options) -> None:
    """Train what is missing, setting by setting; write the results after each run, and the table at the end."""
    if not options.write:
        named = {setting.name: setting for setting in settings()}
        for name, seed in STUDY.missing((name, seed) for name in named for seed in options.seeds):
            STUDY.add((name, seed), *learn(named[name], seed, options))
    write()
    if options.authors is not None:
        draw(read_rows(options.authors))


if __name__ == "__main__":
    main(tyro.cli(Options))
