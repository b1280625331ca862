"""Measure whether curiosity helps where rewards are sparse, idea 4 of the report: `python -m experiments.curiosity`.

Two agents start in the left of five rooms, and their goals are in the right one. They are paid for reaching a goal
alone, do not observe the cost to go, and hardly come upon a goal by chance. PPO learns with each kind of curiosity and
without, with several seeds. Finished runs are reused. `docs/results/curiosity.csv` gets the results, and
`docs/explanation/report.md` the table.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import get_args

import numpy as np
import tyro

from experiments.report import read_progress
from experiments.report_page import spread, write_table
from mapf_pz.instances.instance import Scenario
from mapf_pz.rl.config import CuriosityConfig, CuriosityName, TrainConfig
from mapf_pz.rl.presets import PRESETS
from mapf_pz.rl.training.train import train
from mapf_pz.simulator.kernels.reward import RewardConfig

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "docs" / "results" / "curiosity.csv"

ROOMS = """
....@....@....
....@.........
.........@....
....@....@....
"""
STARTS, GOALS = ((0, 0), (3, 0)), ((0, 13), (3, 13))
KINDS: tuple[CuriosityName, ...] = get_args(CuriosityName)
TITLES = {"none": "none", "rnd": "random network distillation (`rnd`)"}
AGENT_STEPS = 400_000
"""Length of a training."""
REWARD = RewardConfig(forward=0.0, rotate=0.0, goal=1.0)


@dataclass(frozen=True)
class Options:
    """Options of the experiment."""

    output: Path = Path("runs/curiosity")
    """Folder of all runs."""
    kinds: tuple[CuriosityName, ...] = KINDS
    """Kinds of curiosity."""
    seeds: tuple[int, ...] = (0, 1, 2)
    """Random seeds."""
    agent_steps: int = AGENT_STEPS
    """Length of each training."""
    weight: float = 0.1
    """Weight of the curiosity reward."""


def config(kind: CuriosityName, weight: float) -> TrainConfig:
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
        curiosity=CuriosityConfig(kind=kind, weight=weight),
        precision="float32",
    )


def main(options: Options) -> None:
    for seed in options.seeds:
        for kind in options.kinds:
            run = options.output / f"{kind}-{seed}-{options.weight}"
            train(replace(config(kind, options.weight), seed=seed, agent_steps=options.agent_steps), run, overwrite=True)
            print(kind, seed, [round(row["ISR"], 2) for row in read_progress(run)][::12], flush=True)


if __name__ == "__main__":
    main(tyro.cli(Options))
