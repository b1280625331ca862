"""Train a centralized policy, which observes and acts for all agents, as in the report's experiment."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro

from mapf_pz import RandomObstacles
from mapf_pz.evaluation import EvaluationTask, evaluate
from mapf_pz.rl import load_policy, train
from mapf_pz.rl.config import TrainConfig
from mapf_pz.rl.presets import PRESETS


@dataclass(frozen=True)
class Example:
    """Four agents on random 8 x 8 maps."""

    agent_steps: int = 1_000_000
    """Length of training in agent steps."""
    episodes: int = 100
    """Number of evaluation episodes."""
    credit_the_team: bool = False
    """Whether all agents share one advantage, as in the report, which learns more slowly."""
    output: Path = Path("runs/example-central-ppo")
    """Folder of the run."""


def configuration(example: Example) -> TrainConfig:
    """Return the preset with the changes of the example."""
    preset = PRESETS["central-ppo"]
    credit = "team" if example.credit_the_team else "agent"
    return replace(preset, agent_steps=example.agent_steps, ppo=replace(preset.ppo, credit=credit))


def main(example: Example) -> None:
    """Train, evaluate, and print the fraction of episodes in which all agents reached their goals."""
    train(
        configuration(example),
        example.output,
        on_progress=lambda row: print(f"{row['agent_steps']:9.0f} CSR {row['CSR']:.2f}"),
    )
    maps = RandomObstacles(height=8, width=8, density=0.1, num_agents=4)
    task = EvaluationTask("8 x 8", 4, {"source": maps, "max_steps": 64}, example.episodes)
    solved = [episode.metrics["CSR"] for episode in evaluate({"central": load_policy(example.output)}, [task])]
    print(f"CSR on {example.episodes} unseen maps: {np.mean(solved):.2f}")


if __name__ == "__main__":
    main(tyro.cli(Example))
