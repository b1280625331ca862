"""Compare ways to imitate planners: `python -m experiments.policies.imitation`.

Policies imitate LaCAM with one goal per agent, or windowed planning in lifelong episodes, on PRIMAL2's mazes, random
maps and warehouses. Those with cardinal actions differ in whether agents exchange embeddings, in whether they act under
the safety layer while they learn, in how often LaCAM plans again, and in whether states are turned and mirrored.
`oneshot-cardinal` continues from one of these policies, and its agents decide in rounds.
All are evaluated with and without the layer on generated mazes and random maps that none of them has learned on.
`docs/results/imitation.csv` gets the results of each run, which is not repeated then, and
`docs/explanation/imitation.md` the tables. Runs that were stopped go on.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from experiments.pages import FILES, PAGES, spread, write_table
from experiments.report.reproduction import Variation
from experiments.study import Study, StudyOptions, check_known, folder
from mapf_pz.evaluation import EvaluationTask, evaluate
from mapf_pz.instances import MapMixture
from mapf_pz.rl.config import TrainConfig
from mapf_pz.rl.config_file import CONFIG
from mapf_pz.rl.presets import PRESETS
from mapf_pz.rl.progress import read_progress
from mapf_pz.rl.training.train import resume, train

PAGE = PAGES / "imitation.md"
RUNS = Path("runs/imitation")
"""Folder of all runs."""
EXPERTS = {
    "oneshot-cardinal": "LaCAM",
    "lifelong-cardinal": "windowed planning, lifelong",
    "oneshot": "LaCAM, agents that turn",
    "lifelong": "windowed planning, lifelong, agents that turn",
}
"""The planner that each preset imitates."""
BUNDLED = dict.fromkeys(EXPERTS, "augmented") | {"oneshot-cardinal": "in rounds"}
"""The settings of the bundled policies, those of the presets."""
FIRST_RUNS = {"oneshot-cardinal": "oneshot-cardinal-one-round"}
"""The presets of the runs, with the setting `augmented`, from which those of other presets continue."""
FIRST_RUN_SEED = 0
"""Seed of the run from which those with all seeds continue."""
EARLIER: dict[str, dict[str, Any]] = {
    "oneshot-cardinal": {"expert_share": 0.5, "segment_steps": 32, "augment": False},
    "lifelong-cardinal": {"expert": "windowed:rounds=1,window=12", "augment": False},
}
"""How policies with cardinal actions imitate in the settings before `augmented`, with half as many gradient steps."""
EDGE_WEIGHTS = {"oneshot-cardinal": "uniform", "lifelong-cardinal": "crisscross"}
"""The edge weights that agents observe in their costs to go in these settings."""
METRICS = {name: "avg_throughput" if PRESETS[name].task.env.on_target == "restart" else "CSR" for name in EXPERTS}
SETS = {
    "mazes": MapMixture(maps=("primal2",), height=(17, 21), width=(17, 21)),
    "random": MapMixture(height=(17, 21), width=(17, 21), density=(0.1, 0.3)),
}
"""The maps of evaluations."""
TEAMS = (32, 64)
"""Numbers of agents in evaluations."""
MEASURES = tuple(f"{name} {n}" for name, n in itertools.product(SETS, TEAMS))
"""Names of the measures, one for each set and number of agents."""
SHIELDS = {
    "oneshot-cardinal": ("", "+pibt"),
    "lifelong-cardinal": ("", "+pibt:temperature=0,patience=0"),
    "oneshot": ("", "+pibt"),
    "lifelong": ("", "+pibt:temperature=0"),
}
"""What follows the policy's name: without and with the safety layer."""
STUDY = Study(
    FILES / "imitation.csv",
    ("preset", "setting", "seed", "agent_steps"),
    ("hours", *(f"{measure}{layer}" for measure in MEASURES for layer in ("", " with layer"))),
)
"""Each measure without the layer and with it."""


@dataclass(frozen=True)
class Options(StudyOptions):
    """Options of the experiment."""

    output: Path = RUNS
    """Folder of all runs."""
    presets: tuple[str, ...] = tuple(EXPERTS)
    """The presets."""
    settings: tuple[str, ...] = ("own view", "embeddings", "embeddings, no layer")
    """Names of settings."""
    seeds: tuple[int, ...] = (0, 1, 2)
    """Random seeds."""
    agent_steps: int = 8_000_000
    """Length of each training."""
    episodes: int = 64
    """Number of episodes on each set with each number of agents."""


def settings(preset: str) -> Iterator[Variation]:
    """Yield the settings of a preset."""
    augmented = Variation("augmented", PRESETS[FIRST_RUNS.get(preset, preset)])
    if preset in EARLIER:
        yield from _earlier_settings(preset, augmented.config)
    yield augmented
    if preset in FIRST_RUNS:
        first_run = folder(RUNS, f"{preset}-augmented", FIRST_RUN_SEED)
        yield Variation(BUNDLED[preset], replace(PRESETS[preset], initial_policy=str(first_run)))


def bundled(preset: str) -> Variation:
    """Return the setting of the bundled policy of a preset."""
    return next(setting for setting in settings(preset) if setting.name == BUNDLED[preset])


def _earlier_settings(preset: str, augmented: TrainConfig) -> Iterator[Variation]:
    """Yield the settings of a preset with cardinal actions that were before `augmented`."""
    task = augmented.task
    task = replace(task, env=replace(task.env, edge_weights=EDGE_WEIGHTS[preset]), mixture=small_maps(task.mixture))
    optimization = replace(augmented.optimization, num_epochs=1)
    imitation = replace(augmented.imitation, **EARLIER[preset])
    config = replace(augmented, task=task, optimization=optimization, imitation=imitation)
    unshielded = Variation("embeddings, no layer", config)
    together = unshielded.with_("embeddings", task={"shield": True})
    alone = {"communication": 0, "communication_radius": None}
    features = tuple(name for name in task.env.features if name != "pose")
    yield together.with_("own view", env={"features": features}, model=alone)
    yield together
    yield unshielded
    if preset == "oneshot-cardinal":
        short = {"expert_share": 0.3, "segment_steps": 4}
        yield unshielded.with_("plans for 4 steps", optimization={"learning_rate": 1e-3}, imitation=short)


def small_maps(mixture: MapMixture) -> MapMixture:
    """Return a mixture with maps of the sizes of evaluations."""
    return replace(mixture, height=SETS["mazes"].height, width=SETS["mazes"].width)


def main(options: Options) -> None:
    """Train and evaluate the missing runs in sequence; write the results after each, and the tables at the end."""
    check_known("presets", options.presets, tuple(EXPERTS))
    check_known("settings", options.settings, [one.name for preset in options.presets for one in settings(preset)])
    if not options.write:
        for seed, preset in itertools.product(options.seeds, options.presets):
            learn(preset, seed, options)
    write()


def learn(preset: str, seed: int, options: Options) -> None:
    """Train and evaluate the missing runs of a preset and a seed."""
    named = {setting.name: setting.config for setting in settings(preset) if setting.name in options.settings}
    for run in STUDY.missing((preset, name, seed, options.agent_steps) for name in named):
        where = folder(options.output, f"{preset}-{run[1]}", seed)
        hours = trained(named[run[1]], seed, options.agent_steps, where)
        STUDY.add(run, hours | measured(preset, shielded(preset, str(where)), where, options.episodes))


def trained(config: TrainConfig, seed: int, agent_steps: int, run: Path) -> dict[str, str]:
    """Train a policy, or continue to train it; return the hours that it took."""
    if (run / CONFIG).exists():
        resume(run)
    else:
        train(replace(config, seed=seed, agent_steps=agent_steps), run)
    return {"hours": f"{read_progress(run)[-1]['seconds'] / 3600:.2f}"}


def shielded(preset: str, policy: str) -> list[str]:
    """Return the names of a policy without the safety layer and with it."""
    return [f"{policy}{shield}" for shield in SHIELDS[preset]]


def measured(preset: str, policies: Sequence[str], output: Path, episodes: int) -> dict[str, str]:
    """Return the measures of a policy, those with the layer by names of their own; episodes are written to a folder."""
    env = PRESETS[preset].task.env
    rules = {"action_model": env.action_model, "on_target": env.on_target, "max_steps": env.max_steps}
    tasks = [
        EvaluationTask(name, n, rules | {"source": mixture.source(n)}, episodes)
        for (name, mixture), n in itertools.product(SETS.items(), TEAMS)
    ]
    values: dict[str, list[float]] = {}
    for episode in evaluate(policies, tasks, output=output / "evaluation"):
        layer = " with layer" if episode.policy in policies[1:] else ""
        values.setdefault(f"{episode.task} {episode.num_agents}{layer}", []).append(episode.metrics[METRICS[preset]])
    return {column: f"{np.mean(numbers):.3f}" for column, numbers in values.items()}


def write() -> None:
    """Write the tables."""
    found = STUDY.rows()
    for preset in EXPERTS:
        rows = [row for row in found if row["preset"] == preset]
        write_table(PAGE, f"imitation {preset}", table(preset, rows))


def table(preset: str, rows: Sequence[Mapping[str, str]]) -> Iterator[str]:
    """Yield the results of a preset as Markdown: means over seeds, in brackets the smallest and the largest."""
    yield f"| imitation of {EXPERTS[preset]} | seeds | million agent steps | hours | {' | '.join(MEASURES)} |"
    yield f"| {' | '.join(['---'] * (4 + len(MEASURES)))} |"
    for name, steps in dict.fromkeys((row["setting"], row["agent_steps"]) for row in rows):
        runs = [row for row in rows if (row["setting"], row["agent_steps"]) == (name, steps)]
        cells = [f"{len(runs)}", f"{int(steps) / 1e6:g}", spread([float(row["hours"]) for row in runs], 1)]
        for measure in MEASURES:
            alone, layer = ([float(row[key]) for row in runs] for key in (measure, f"{measure} with layer"))
            cells.append(f"{spread(alone, 2)}; {spread(layer, 2)}")
        yield f"| {name} | {' | '.join(cells)} |"


if __name__ == "__main__":
    main(tyro.cli(Options))
