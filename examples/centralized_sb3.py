"""Stable-Baselines3, the report's library, on the centralized environment: `pip install stable-baselines3`."""

from dataclasses import dataclass

import numpy as np
import torch
import tyro
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env

from mapf_pz import RandomObstacles
from mapf_pz.wrappers import CentralizedEnv, centralized_env


@dataclass(frozen=True)
class Example:
    """Two agents on small random maps; `MultiInputPolicy` flattens `float32` images."""

    steps: int = 200_000
    """Length of training in environment steps."""
    episodes: int = 50
    """Number of evaluation episodes."""
    seed: int = 0
    """Random seed of weights, exploration and instances."""


def make_env() -> CentralizedEnv:
    """Return the environment, with the cost to go in the observations and rewards for progress."""
    return centralized_env(
        source=RandomObstacles(height=6, width=6, density=0.1, num_agents=2),
        max_steps=32,
        channels=("view", "cost_to_go", "others_next"),
        features=("action_advantage",),
        reward="progress",
    )


def main(example: Example) -> None:
    """Train and evaluate the policy."""
    torch.set_num_threads(1)  # several threads are slower for a network this small, above all where cores are busy
    envs = make_vec_env(make_env, n_envs=8, seed=example.seed)
    model = PPO("MultiInputPolicy", envs, n_steps=128, batch_size=256, gamma=0.98, seed=example.seed, device="cpu")
    model.learn(example.steps)

    env, solved = make_env(), []
    for episode in range(example.episodes):
        observation, info = env.reset(seed=1_000_000 + episode)
        over = False
        while not over:
            action, _ = model.predict(observation)  # pyright: ignore[reportArgumentType] (annotated without dicts)
            observation, _, terminated, truncated, info = env.step(action)
            over = terminated or truncated
        solved.append(info["is_success"])
    print(f"CSR on {example.episodes} unseen maps: {np.mean(solved):.2f}")


if __name__ == "__main__":
    main(tyro.cli(Example))
