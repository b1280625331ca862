"""Gymnasium's vector environments: teams that are stepped together, as one batch, one by one, or in processes."""

from dataclasses import dataclass
from typing import Literal

import gymnasium
import numpy as np
import tyro

METRICS = ("CSR", "ISR", "ep_length")


@dataclass(frozen=True)
class Example:
    """A team of agents that acts at random."""

    num_envs: int = 4
    """Environments that are stepped together."""
    steps: int = 500
    """Steps of each of them; an episode that ends begins anew by itself."""
    vectorization_mode: Literal["vector_entry_point", "sync", "async"] = "vector_entry_point"
    """The batch of this package, which is the fastest; one after the other; or each in a process of its own."""
    seed: int = 0
    """Decides instances and actions."""


def main(example: Example) -> None:
    """Play, and print the means over the episodes that ended."""
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
