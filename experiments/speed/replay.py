"""How fast demonstrations are replayed."""

from __future__ import annotations

from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory

from experiments.speed.runs import Run, measure, timed
from mapf_pz.rl.demonstrations import DatasetConfig, load_dataset, make_dataset
from mapf_pz.simulator.config import EnvConfig

OBSERVATIONS = {
    "view_size": (7, 7),
    "view": "centered",
    "channels": ("view", "cost_to_go", "orientation", "others_next", "others_at_goal"),
    "features": ("action_advantage", "last_actions"),
    "num_last_actions": 2,
}


def main(
    num_agents: tuple[int, ...] = (8, 32), num_envs: int = 32, steps: int = 1000, runs: int = 5, episodes: int = 200
) -> None:
    """Replay demonstrations of PIBT on random maps of 12 x 12 cells, at most 128 steps long.

    Prints the agent steps per second of CPU time of `Dataset.batches`, with the observations of training, as the median
    of several runs.

    Args:
        num_agents: numbers of agents.
        num_envs: number of environments that are stepped together.
        steps: number of steps of these in a run.
        runs: number of runs.
        episodes: number of demonstrations.
    """
    replays = dict(_replay(count, num_envs, steps, episodes) for count in num_agents)
    for one in measure(replays, min_runs=runs).values():
        print(f"{one.name}: {one.cpu_rate:,.0f} agent steps per second")


def _replay(num_agents: int, num_envs: int, steps: int, episodes: int) -> tuple[str, Run]:
    """Return a description of demonstrations, and a run that replays them."""
    with TemporaryDirectory() as folder:
        env = EnvConfig(max_steps=128)
        make_dataset(DatasetConfig(planner="pibt", env=env, num_agents=(num_agents,), episodes=episodes), Path(folder))
        data = load_dataset(folder)
    batches = data.batches(OBSERVATIONS, num_envs)
    name = f"{num_agents} agents, {data.num_steps.mean():.1f} steps per episode"
    return name, timed(lambda: sum(batch.actions.size for batch in islice(batches, steps)))
