"""Measure how fast demonstrations are replayed: `PYTHONPATH=. python experiments/replay_speed.py`.

Prints the agent steps per second of CPU time of `Dataset.batches`, with the observations of training, as the median of
several runs.
"""

from __future__ import annotations

import time
from itertools import islice
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

import tyro

from mapf_pz.rl.demonstrations import DatasetConfig, load_dataset, make_dataset
from mapf_pz.simulator.config import EnvConfig

OBSERVATIONS = {
    "view_size": (7, 7),
    "view": "centered",
    "channels": ("view", "cost_to_go", "orientation", "others_next", "others_at_goal"),
    "features": ("action_advantage", "last_actions"),
    "num_last_actions": 2,
}


def replay_speed(
    num_agents: tuple[int, ...] = (8, 32), num_envs: int = 32, steps: int = 1000, runs: int = 5, episodes: int = 200
) -> None:
    """Replay demonstrations of PIBT on random maps of 12 x 12 cells, at most 128 steps long.

    Args:
        num_agents: numbers of agents.
        num_envs: number of environments that are stepped together.
        steps: number of steps of these in a run.
        runs: number of runs.
        episodes: number of demonstrations.
    """
    for count in num_agents:
        with TemporaryDirectory() as name:
            config = DatasetConfig(planner="pibt", env=EnvConfig(max_steps=128), num_agents=(count,), episodes=episodes)
            make_dataset(config, Path(name))
            data = load_dataset(name)
        batches = data.batches(OBSERVATIONS, num_envs)
        next(batches)
        speeds: list[float] = []
        for _ in range(runs):
            start = time.process_time()
            total = sum(batch.actions.size for batch in islice(batches, steps))
            speeds.append(total / (time.process_time() - start))
        length = data.num_steps.mean()
        print(f"{count} agents, {length:.1f} steps per episode: {median(speeds):,.0f} agent steps per second")


if __name__ == "__main__":
    tyro.cli(replay_speed)
