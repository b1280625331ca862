"""Train a shared policy with Stable-Baselines3 and SuperSuit: `pip install stable-baselines3 supersuit`.

SuperSuit requires that the episodes of all agents end at the same time, as with `on_target="nothing"`.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import supersuit
import torch
import tyro
from stable_baselines3 import PPO
from stable_baselines3.common.utils import set_random_seed

import mapf_pz
from mapf_pz.instances import RandomObstacles


@dataclass(frozen=True)
class Example:
    """Two agents on small random maps."""

    steps: int = 200_000
    """Length of training in agent steps."""
    episodes: int = 50
    """Number of evaluation episodes."""
    seed: int = 0
    """Random seed of weights, exploration and instances."""


def make_env() -> mapf_pz.MapfEnv:
    """Return the environment, with the cost to go in the observations and rewards for progress."""
    maps = RandomObstacles(height=6, width=6, density=0.1, num_agents=2)
    return mapf_pz.parallel_env(
        source=maps,
        max_steps=32,
        reward="progress",
        channels=("view", "cost_to_go", "others_next"),
        features=("action_advantage",),
    )


def main(example: Example) -> None:
    """Train and evaluate the policy."""
    torch.set_num_threads(1)  # several threads are slower for a network this small, above all where cores are busy
    agents: Any = supersuit.pettingzoo_env_to_vec_env_v1(make_env())
    envs: Any = supersuit.concat_vec_envs_v1(agents, 8, base_class="stable_baselines3")
    envs.venv.reset(seed=example.seed)  # all eight are copies, which would otherwise generate the same instances
    set_random_seed(example.seed)  # PPO(seed=...) calls a method that SuperSuit's environments lack
    model = PPO("MultiInputPolicy", envs, n_steps=128, batch_size=256, gamma=0.98, device="cpu")
    model.learn(example.steps)

    env, solved = make_env(), []
    for episode in range(example.episodes):
        seen, _ = env.reset(seed=1_000_000 + episode)
        while env.agents:
            seen = env.step({agent: int(model.predict(seen[agent])[0]) for agent in env.agents})[0]
        solved.append(env.metrics()["CSR"])
    print(f"CSR on {example.episodes} unseen maps: {np.mean(solved):.2f}")


if __name__ == "__main__":
    main(tyro.cli(Example))
