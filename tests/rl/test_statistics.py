"""Statistics that runs report, and the distributions that policies sample from; all seeds are fixed."""

import dataclasses

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torch import nn

import mapf_pz
from mapf_pz.rl.algorithms.named import ALGORITHMS
from mapf_pz.rl.config import TaskConfig
from mapf_pz.rl.policies.policy import SharedPolicy
from mapf_pz.rl.ranks import Ranks
from mapf_pz.rl.training.episodes import EpisodesByStart
from mapf_pz.rl.training.validation import Validation
from mapf_pz.simulator.actions import CardinalAction
from mapf_pz.simulator.seeds import FIRST_VALIDATION_SEED
from tests.helpers.small_run import TINY, changed


def test_validation_counts_the_first_episode_of_each_environment():
    """An agent that always moves right in a corridor succeeds if its goal is to the right, and then soon."""
    fields = {"num_agents": 1, "max_steps": 12, "view_size": (1, 3), "action_model": "cardinal"}
    task = changed(TaskConfig(), height=1, width=6, density=0, **fields)
    config = dataclasses.replace(TINY, task=task, validation_episodes=40)
    algorithm = ALGORITHMS["mappo"](config)
    algorithm.network.head[-1].bias.data[CardinalAction.RIGHT] = 50
    env = mapf_pz.parallel_env(**task.env_keywords())
    solved = []
    for seed in range(FIRST_VALIDATION_SEED, FIRST_VALIDATION_SEED + 40):
        env.reset(seed=seed)
        solved.append(env.goals[0, 1] > env.positions[0, 1])
    found = Validation(algorithm, config, Ranks()).measure()
    assert 10 < sum(solved) < 30
    assert found["validation_CSR"] == found["validation_ISR"] == pytest.approx(np.mean(solved))


def test_training_episodes_count_where_they_started():
    """Environment 0 is solved every 2 steps; environment 1 fails after 8 steps, the maximum."""
    optimization = dataclasses.replace(TINY.optimization, num_envs=2, steps_per_batch=4)
    config = dataclasses.replace(TINY, task=changed(TINY.task, max_steps=8), optimization=optimization)
    episodes = EpisodesByStart(config)
    found = []
    for update in range(4):
        step_count = torch.tensor([[1, 2, 1, 2], [1, 2, 3, 4] if update % 2 == 0 else [5, 6, 7, 8]])
        solved, failed = step_count == 2, step_count == 8
        solved[1] = False
        agents = {
            "at_goal": solved.reshape(2, 4, 1, 1),
            "arrivals": solved.reshape(2, 4, 1, 1).long(),
            "episode_reward": step_count.reshape(2, 4, 1, 1).float(),
        }
        entries = {"agents": TensorDict(agents, [2, 4, 1]), "step_count": step_count[..., None]}
        entries |= {"terminated": solved[..., None], "done": (solved | failed)[..., None]}
        found.append(episodes.after(update, TensorDict({"next": TensorDict(entries, [2, 4])}, [2, 4])))
    assert [row["episodes"] for row in found] == [0, 0, 3, 2]
    assert np.isnan([found[0]["CSR"], found[1]["return"]]).all()
    assert found[2] == {"episodes": 3, "CSR": pytest.approx(2 / 3), "ISR": pytest.approx(2 / 3), "return": 4}
    assert found[3] == {"episodes": 2, "CSR": 1, "ISR": 1, "return": 2}


class FixedLogits(nn.Module):
    """The same logits for every agent, whatever it observes."""

    def __init__(self, logits):
        super().__init__()
        self.logits = logits

    def forward(self, image, features=None):
        return (self.logits.expand(*image.shape[:-3], -1),)


def test_a_shared_policy_samples_from_the_softmax_of_its_logits():
    probabilities, num_agents = torch.tensor([0.5, 0.3, 0.15, 0.05]), 10_000
    config = dataclasses.replace(TINY, task=changed(TINY.task, features=()))
    policy = SharedPolicy(FixedLogits(probabilities.log() + 3), config, seed=1)
    observation = np.zeros((5, 3, 3), np.float32)
    actions = policy.act({f"agent_{i}": observation for i in range(num_agents)})
    observed = np.bincount(list(actions.values()), minlength=4)
    expected = num_agents * probabilities.numpy()
    # Chi-squared with 3 degrees of freedom exceeds 16.27 with probability 0.001.
    assert ((observed - expected) ** 2 / expected).sum() < 16.27
