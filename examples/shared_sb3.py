"""Train a policy that all agents share with Stable-Baselines3: `pip install stable-baselines3 sb3-contrib`.

`AgentVecEnv` makes each agent one environment. `MaskablePPO` reads their action masks; Stable-Baselines3's PPO
can be used in its place.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
import tyro
from sb3_contrib import MaskablePPO

import mapf_pz
from mapf_pz import RandomObstacles
from mapf_pz.wrappers.sb3 import AgentVecEnv


@dataclass(frozen=True)
class Example:
    """Two agents on small random maps."""

    steps: int = 200_000
    """Length of training in agent steps."""
    episodes: int = 50
    """Number of evaluation episodes."""
    seed: int = 0
    """Random seed of weights, exploration and instances."""


def keywords() -> dict[str, Any]:
    """Return the settings: the cost to go in the observations, and rewards for progress."""
    return {
        "source": RandomObstacles(height=6, width=6, density=0.1, num_agents=2),
        "max_steps": 32,
        "reward": "progress",
        "channels": ("view", "cost_to_go", "others_next"),
        "features": ("action_advantage",),
    }


def main(example: Example) -> None:
    """Train and evaluate the policy."""
    torch.set_num_threads(1)  # several threads are slower for a network this small, above all where cores are busy
    envs = AgentVecEnv(8, **keywords())
    model = MaskablePPO(
        "MultiInputPolicy", envs, n_steps=128, batch_size=256, gamma=0.98, device="cpu", seed=example.seed
    )
    model.learn(example.steps)

    env, solved = mapf_pz.parallel_env(**keywords()), []
    for episode in range(example.episodes):
        seen, infos = env.reset(seed=1_000_000 + episode)
        while env.agents:
            masks = {agent: infos[agent]["action_mask"] for agent in env.agents}
            actions = {agent: int(model.predict(seen[agent], action_masks=masks[agent])[0]) for agent in env.agents}
            seen, _, _, _, infos = env.step(actions)
        solved.append(env.metrics()["CSR"])
    print(f"CSR on {example.episodes} unseen maps: {np.mean(solved):.2f}")


if __name__ == "__main__":
    main(tyro.cli(Example))
