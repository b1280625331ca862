"""Train agents with IPPO, whose critic uses local observations, and evaluate more agents on a larger map."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro

from mapf_pz import RandomObstacles
from mapf_pz.evaluation import EvaluationTask, evaluate
from mapf_pz.evaluation.reports.intervals import interval
from mapf_pz.rl import load_policy, train
from mapf_pz.rl.presets import PRESETS


@dataclass(frozen=True)
class Example:
    """Eight agents in training, and up to 32 in the evaluation."""

    agent_steps: int = 1_000_000
    """Length of training in agent steps. One seed brought 1, 69 and 99 % of 32 agents to their goals after 100
    thousand, 300 thousand and a million, which took 22, 32 and 69 seconds of a core, the evaluation included."""
    episodes: int = 50
    """Number of evaluation episodes for each number of agents."""
    output: Path = Path("runs/example-ippo")
    """Folder of the run."""


def main(example: Example) -> None:
    """Train, and print the fraction of agents that reach their goals for increasing numbers of agents."""
    config = replace(PRESETS["quickstart"], algorithm="ippo", agent_steps=example.agent_steps)
    train(config, example.output, on_progress=lambda row: print(f"{row['agent_steps']:9.0f} ISR {row['ISR']:.2f}"))

    policy = load_policy(example.output)
    for num_agents in (8, 16, 32):
        maps = RandomObstacles(height=20, width=20, density=0.15, num_agents=num_agents)
        task = EvaluationTask("20 x 20", num_agents, {"source": maps, "max_steps": 160}, example.episodes)
        shares = [episode.metrics["ISR"] for episode in evaluate({"ippo": policy}, [task])]
        low, high = interval("ISR", shares)
        print(f"{task.label}: ISR {np.mean(shares):.3f} [{low:.3f}, {high:.3f}]")


if __name__ == "__main__":
    main(tyro.cli(Example))
