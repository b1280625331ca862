"""Train the report's centralized policy, in the report's warehouse, until it routes ten agents.

One network observes and acts for all agents that turn: their observations are stacked, two convolutions and a linear
layer make 128 features, and two networks of 2 x 64 make the policy's action matrix and the value. The preset
`report-repaired` adds what the report's policy lacked: see `docs/explanation/report.md`.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro

from mapf_pz.evaluation import EvaluationTask, evaluate
from mapf_pz.rl import load_policy, train
from mapf_pz.rl.presets import PRESETS


@dataclass(frozen=True)
class Example:
    """Ten agents in `warehouse-10-20-10-2-1`."""

    agent_steps: int = 1_000_000
    """Length of training in agent steps; a core takes about seven minutes for a million."""
    seed: int = 0
    """Random seed of the training."""
    episodes: int = 10
    """Number of the MAPF benchmark's scenarios to evaluate on, `random-1` and those that follow, at most 10."""
    max_steps: int = 1000
    """Maximum number of steps of an evaluation episode."""
    output: Path = Path("runs/example-central-ppo")
    """Folder of the run."""


def main(example: Example) -> None:
    """Train, and print the fraction of the scenarios in which all agents reach their goals."""
    config = replace(PRESETS["report-repaired"], agent_steps=example.agent_steps, seed=example.seed)
    train(
        config,
        example.output,
        on_progress=lambda row: print(f"{row['agent_steps']:9.0f} CSR {row['CSR']:.2f} ISR {row['ISR']:.2f}"),
    )
    policies = {"trained": load_policy(example.output)}
    metrics = []
    for k in range(1, example.episodes + 1):
        keywords = {"map": config.task.env.map, "scenario": f"random-{k}", "max_steps": example.max_steps}
        task = EvaluationTask(f"random-{k}", 10, keywords, episodes=1)
        metrics += [episode.metrics for episode in evaluate(policies, [task])]
    solved, arrived, ratio = (np.mean([row[name] for row in metrics]) for name in ("CSR", "ISR", "SoC_ratio"))
    print(f"CSR on {example.episodes} scenarios: {solved:.2f}, ISR {arrived:.2f}, SoC_ratio {ratio:.2f}")


if __name__ == "__main__":
    main(tyro.cli(Example))
