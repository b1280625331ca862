"""Measure whether curiosity helps where rewards are sparse: `python -m experiments.ideas.curiosity`.

It is idea 4 of the report. Two agents start in the left of three rooms, and their goals are in the right one. They are
paid only for reaching their goals, do not observe the cost to go, and hardly come upon a goal by chance. PPO learns
without curiosity and with each kind of it, with three seeds. `docs/results/curiosity.csv` gets the results, whose runs
are not repeated, and `docs/explanation/report-ideas.md` the table.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import get_args

import numpy as np
import tyro

from experiments.pages import FILES, PAGES, spread, write_table
from experiments.study import Study, StudyOptions, folder
from mapf_pz.instances.instance import Scenario
from mapf_pz.rl.config import CuriosityConfig, CuriosityName, TrainConfig
from mapf_pz.rl.presets import PRESETS
from mapf_pz.rl.progress import read_progress
from mapf_pz.rl.training.train import train
from mapf_pz.simulator.kernels.reward import RewardConfig

PAGE = PAGES / "report-ideas.md"

ROOMS = """
....@....@....
....@.........
.........@....
....@....@....
"""
STARTS, GOALS = ((0, 0), (3, 0)), ((0, 13), (3, 13))
REWARD = RewardConfig(forward=0.0, rotate=0.0, goal=1.0)
AGENT_STEPS = 400_000
"""Length of a training."""
SOLVED = 0.9
"""Fraction of the agents that reach their goals in the episodes of an update, from which on the task is solved."""
STUDY = Study(FILES / "curiosity.csv", ("curiosity", "seed"), ("solved", "ISR"))
"""Of each kind and seed, the agent steps until the task is solved (empty: it is not), and the ISR of the last tenth."""


@dataclass(frozen=True)
class Options(StudyOptions):
    """Options of the experiment."""

    output: Path = Path("runs/curiosity")
    """Folder of all runs."""
    seeds: tuple[int, ...] = (0, 1, 2)
    """Random seeds."""
    agent_steps: int = AGENT_STEPS
    """Length of each training."""


def config(kind: CuriosityName) -> TrainConfig:
    """Return the training of two agents in the rooms with a kind of curiosity."""
    preset = PRESETS["quickstart"]
    env = replace(
        preset.task.env,
        map=ROOMS,
        scenario=Scenario(np.array(STARTS), np.array(GOALS)),
        num_agents=2,
        max_steps=96,
        on_target="finish",
        initial_heading="east",
        channels=("view", "goal", "orientation"),
        features=("goal_vector", "pose"),
        reward=REWARD,
    )
    return replace(
        preset,
        task=replace(preset.task, env=env),
        optimization=replace(preset.optimization, num_envs=32, minibatch_size=256, num_epochs=4),
        curiosity=CuriosityConfig(kind=kind),
        precision="float32",
    )


def main(options: Options) -> None:
    """Train the missing runs in sequence, write the results after each, and the table at the end."""
    if not options.write:
        for kind, seed in STUDY.missing((kind, seed) for seed in options.seeds for kind in get_args(CuriosityName)):
            run = folder(options.output, kind, seed)
            train(replace(config(kind), seed=seed, agent_steps=options.agent_steps), run, overwrite=True)
            STUDY.add((kind, seed), _measures(run))
    write()


def write() -> None:
    """Write the table."""
    write_table(PAGE, "curiosity", table(STUDY.rows()))


def _measures(run: Path) -> dict[str, str]:
    """Return when a run solved the task, and how well at the end."""
    progress = read_progress(run)
    rates = np.array([row["ISR"] for row in progress])
    solved = np.flatnonzero(rates >= SOLVED)
    steps = f"{progress[solved[0]]['agent_steps']:.0f}" if len(solved) else ""
    return {"solved": steps, "ISR": f"{np.nanmean(rates[-len(rates) // 10 :]):.3f}"}


def table(rows: Sequence[Mapping[str, str]]) -> Iterator[str]:
    """Yield the lines of the table in Markdown, kinds in the order of the configuration."""
    yield "| curiosity | solved after, thousand agent steps, of each seed | ISR at the end |"
    yield "| --- | --- | --- |"
    for kind in get_args(CuriosityName):
        chosen = [row for row in rows if row["curiosity"] == kind]
        solved = ", ".join(f"{float(row['solved']) / 1000:.0f}" if row["solved"] else "not" for row in chosen)
        yield f"| `{kind}` | {solved} | {spread([float(row['ISR']) for row in chosen], 2)} |"


if __name__ == "__main__":
    main(tyro.cli(Options))
