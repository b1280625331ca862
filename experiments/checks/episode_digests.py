"""Print a digest of random episodes, to compare two versions: `python -m experiments.checks.episode_digests`.

The episodes have random maps, rules, observations and actions. Observations, rewards, ends, masks, infos and metrics
are in the digest, so two versions with the same digest behave the same in these episodes.
"""

from __future__ import annotations

from dataclasses import dataclass
from hashlib import sha256
from typing import Any

import numpy as np
import tyro

import mapf_pz
from mapf_pz.instances import RandomObstacles

CHANNELS = ("view", "goal", "orientation", "edge_weights", "cost_to_go", "heuristic", "other_goals", "others_next")
FEATURES = ("goal_vector", "location", "action_advantage", "last_actions", "time")


@dataclass(frozen=True)
class Episodes:
    """Random episodes."""

    episodes: int = 200
    """Number of episodes."""
    seed: int = 0
    """Seed of the first episode."""


def make_env(rng: np.random.Generator) -> mapf_pz.MapfEnv:
    """Return an environment with random settings."""
    height, width = rng.integers(4, 12, size=2).tolist()
    action_model: Any = rng.choice(["rotate", "cardinal"])
    view: Any = "centered" if action_model == "cardinal" else rng.choice(["front", "centered"])
    frame: Any = "egocentric" if view == "front" else rng.choice(["egocentric", "map"])
    if action_model == "cardinal":
        frame = "map"
    channels = tuple(name for name in CHANNELS if rng.random() < 0.5) or CHANNELS
    return mapf_pz.parallel_env(
        source=RandomObstacles(height, width, float(rng.choice([0, 0.1, 0.2])), int(rng.integers(1, 6))),
        max_steps=int(rng.integers(5, 40)),
        action_model=action_model,
        collision_system=rng.choice(["soft", "priority", "block_both"]),
        on_target=rng.choice(["nothing", "finish", "restart"]),
        view=view,
        frame=frame,
        view_size=tuple(rng.integers(1, 8, size=2).tolist()),
        see_through_walls=bool(rng.random() < 0.5),
        channels=channels,
        features=tuple(name for name in FEATURES if rng.random() < 0.4),
        edge_weights=rng.choice(["uniform", "random", "crisscross"]),
        reward=rng.choice(["report", "progress"]),
    )


def _content(value: Any) -> str:
    """Return the numbers of a value as text."""
    if isinstance(value, dict):
        return repr([(name, _content(part)) for name, part in sorted(value.items())])
    array = np.asarray(value)
    return f"{array.dtype} {array.shape} {array.tobytes().hex()}"


def episode_digest(seed: int) -> str:
    """Return the digest of the episode of a seed."""
    rng, found = np.random.default_rng(seed), sha256()
    env = make_env(rng)
    observations, infos = env.reset(seed=seed)
    found.update(_content({"observations": observations, "infos": infos, "state": env.state()}).encode())
    while env.agents:
        actions = {name: int(rng.choice(np.flatnonzero(infos[name]["action_mask"]))) for name in env.agents}
        observations, rewards, terminated, truncated, infos = env.step(actions)
        parts = {"observations": observations, "rewards": rewards, "terminated": terminated, "truncated": truncated}
        found.update(_content(parts | {"infos": infos, "state": env.state()}).encode())
    found.update(_content(env.metrics()).encode())
    return found.hexdigest()


def main(options: Episodes) -> None:
    """Print the digest of all episodes."""
    found = sha256()
    for seed in range(options.seed, options.seed + options.episodes):
        found.update(episode_digest(seed).encode())
    print(f"{options.episodes} episodes: {found.hexdigest()}")


if __name__ == "__main__":
    main(tyro.cli(Episodes))
