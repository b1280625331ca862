"""Three tasks that are learned within seconds, and how the learning curves of the tests were recorded.

`python -m tests.rl.learning_curves` trains each task with the seeds 100 to 111, and prints the mean and the standard
deviation of both measures.
"""

import dataclasses
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from mapf_pz.rl import train
from mapf_pz.rl.config import ModelConfig, OptimizationConfig, PPOConfig, TaskConfig, TrainConfig
from mapf_pz.simulator.config import RewardConfig
from tests.helpers.small_run import changed

# Two agents on an empty map are rewarded for each step closer to the goal, and observe which moves lead there. The
# entropy bonus is large enough to decide how far the policies get.
ENV = {
    "num_agents": 2,
    "max_steps": 8,
    "view_size": (1, 1),
    "action_model": "cardinal",
    "channels": ("cost_to_go",),
    "features": ("action_advantage",),
    "reward": RewardConfig(forward=0.0, rotate=0.0, goal=0.0, progress=0.2),
}
MAPPO = TrainConfig(
    task=changed(TaskConfig(), height=8, width=8, density=0, **ENV),
    model=ModelConfig(conv_channels=(4,), hidden=16, head=(16,)),
    optimization=OptimizationConfig(num_envs=32, steps_per_batch=16, minibatch_size=128, learning_rate=0.01),
    ppo=PPOConfig(entropy_coeff=0.3),
    agent_steps=6 * 32 * 16 * 2,
)
TASKS = {
    "mappo": MAPPO,
    "recurrent-ippo": dataclasses.replace(MAPPO, algorithm="ippo", model=dataclasses.replace(MAPPO.model, recurrent=8)),
    "central-ppo": dataclasses.replace(MAPPO, algorithm="central-ppo"),
}


def measure(config, seed):
    """Train; return the mean return of episodes that start in updates 2 to 4, and the entropy in the last update."""
    rows = []
    with TemporaryDirectory() as folder:
        train(dataclasses.replace(config, seed=seed), Path(folder), rows.append)
    # A row has the return of the episodes that started in the update before.
    return np.mean([row["return"] for row in rows[2:5]]), rows[-1]["entropy"]


if __name__ == "__main__":
    for name, config in TASKS.items():
        found = np.array([measure(config, seed) for seed in range(100, 112)])
        print(name, found.mean(0), found.std(0, ddof=1))
