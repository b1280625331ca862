"""One policy of Stable-Baselines3 for every agent, by way of SuperSuit: `pip install stable-baselines3 supersuit`.

SuperSuit needs agents that end together, as they do with `on_target="nothing"`.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import supersuit
import tyro
from stable_baselines3 import PPO
from stable_baselines3.common.utils import set_random_seed

import mapf_pz
from mapf_pz.instances import RandomObstacles


@dataclass(frozen=True)
class Example:
    """Two agents on small random maps."""

    steps: int = 200_000
    """Agent steps of training: steps of all agents together."""
    episodes: int = 50
    """How many episodes to evaluate."""
    seed: int = 0
    """Decides weights, exploration and instances."""


def make_env() -> mapf_pz.MapfEnv:
    """Return the environment: the cost to go is in sight, and every bit of the way is rewarded."""
    maps = RandomObstacles(height=6, width=6, density=0.1, num_agents=2)
    seen = {"channels": ("view", "cost_to_go", "others_next"), "features": ("action_advantage",)}
    return mapf_pz.parallel_env(source=maps, max_steps=32, reward="progress", **seen)


def main(example: Example) -> None:
    """Train and evaluate."""
    agents: Any = supersuit.pettingzoo_env_to_vec_env_v1(make_env())
    envs: Any = supersuit.concat_vec_envs_v1(agents, 8, base_class="stable_baselines3")
    envs.venv.reset(seed=example.seed)  # all eight are copies of one, and would draw the same instances
    set_random_seed(example.seed)  # PPO(seed=...) asks for a method that SuperSuit's environments do not have
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
