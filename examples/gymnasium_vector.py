"""Gymnasium's vector environments: several teams as one batch, sequentially, or in processes."""

from dataclasses import dataclass
from typing import Literal

import gymnasium
import numpy as np
import tyro

METRICS = ("CSR", "ISR", "ep_length")


@dataclass(frozen=True)
class Example:
    """A team of agents with random actions."""

    num_envs: int = 4
    """Number of environments."""
    steps: int = 500
    """Number of steps of each environment, which resets itself after an episode."""
    vectorization_mode: Literal["vector_entry_point", "sync", "async"] = "vector_entry_point"
    """`vector_entry_point`: the batch of this package, which is the fastest; `sync`: sequential; `async`: processes."""
    seed: int = 0
    """Random seed of instances and actions."""


def main(example: Example) -> None:
    """Run the environments, and print means over the finished episodes."""
    envs = gymnasium.make_vec(
        "mapf_pz:Mapf-Centralized-v0",
        num_envs=example.num_envs,
        vectorization_mode=example.vectorization_mode,
        map="empty-8-8",
        num_agents=2,
        max_steps=100,
    )
    envs.reset(seed=example.seed)
    envs.action_space.seed(example.seed)
    finished: list[tuple[float, ...]] = []
    for _ in range(example.steps):
        _, _, terminated, truncated, infos = envs.step(envs.action_space.sample())
        over = terminated | truncated
        finished += zip(*(infos[name][over] for name in METRICS), strict=True) if over.any() else []
    envs.close()
    means = zip(METRICS, np.mean(finished, axis=0), strict=True)
    print(f"{len(finished)} episodes: " + ", ".join(f"{name} {mean:.3f}" for name, mean in means))


if __name__ == "__main__":
    main(tyro.cli(Example))
