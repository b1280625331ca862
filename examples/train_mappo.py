"""Train decentralized agents with MAPPO, and evaluate them on unseen maps."""

from dataclasses import dataclass, replace
from pathlib import Path

import tyro

import mapf_pz
from mapf_pz.instances import MapMixture
from mapf_pz.rl import load_policy, train
from mapf_pz.rl.config import TRAINING_ENV, TaskConfig, TrainConfig


@dataclass(frozen=True)
class Example:
    """Eight agents on random maps."""

    agent_steps: int = 1_000_000
    """Length of training in agent steps."""
    episodes: int = 100
    """Number of evaluation episodes."""
    output: Path = Path("runs/example")
    """Folder of the run."""


def main(example: Example) -> float:
    """Train, evaluate, and return the fraction of episodes in which all agents reached their goals."""
    mixture = MapMixture(height=12, width=12, density=0.15)
    task = TaskConfig(replace(TRAINING_ENV, num_agents=8, max_steps=96), mixture)
    config = replace(TrainConfig(), task=task, agent_steps=example.agent_steps)
    train(config, example.output, on_progress=lambda row: print(f"{row['agent_steps']:9.0f} CSR {row['CSR']:.2f}"))

    policy = load_policy(example.output)
    env = mapf_pz.parallel_env(**policy.env_kwargs, source=mixture.source(num_agents=8), max_steps=96)
    solved = 0.0
    for episode in range(example.episodes):
        observations, _ = env.reset(seed=1_000_000 + episode)
        policy.reset_states()
        while env.agents:
            observations = env.step(policy.act(observations))[0]
        solved += env.metrics()["CSR"]
    print(f"CSR on {example.episodes} unseen maps: {solved / example.episodes:.2f}")
    return solved / example.episodes


if __name__ == "__main__":
    main(tyro.cli(Example))
