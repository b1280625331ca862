"""Train DQN of Tianshou with action masks and one network for all agents: `pip install tianshou==2.0.1`."""

# pyright: reportMissingImports=false, reportUntypedBaseClass=false

import logging
import sys

import numpy as np
import torch
from tianshou.algorithm.modelfree.dqn import DQN, DiscreteQLearningPolicy
from tianshou.algorithm.multiagent.marl import MultiAgentOffPolicyAlgorithm
from tianshou.algorithm.optim import AdamOptimizerFactory
from tianshou.data import Collector, VectorReplayBuffer
from tianshou.env import DummyVectorEnv, PettingZooEnv
from tianshou.trainer import OffPolicyTrainerParams
from tianshou.utils.net.common import Net

import mapf_pz
from mapf_pz.wrappers import FlatObservations, MaskedObservations, to_aec

NUM_AGENTS = 4
MAPS = mapf_pz.RandomObstacles(height=8, width=8, density=0.1, num_agents=NUM_AGENTS)


def make_env() -> PettingZooEnv:
    """Return an environment with masks in its observations, where Tianshou looks for them."""
    env = mapf_pz.parallel_env(source=MAPS, max_steps=32, **mapf_pz.RECOMMENDED)
    return PettingZooEnv(to_aec(MaskedObservations(FlatObservations(env))))


def main(steps: int) -> None:
    """Train on random maps, where a step is one of a single agent, and print the CSR of episodes on others."""
    logging.getLogger("tianshou").setLevel(logging.ERROR)
    torch.set_num_threads(1)
    torch.manual_seed(0)
    np.random.seed(0)  # noqa: NPY002 (Tianshou's generator)
    env = make_env()
    space, actions = env.observation_space["observation"], env.action_space
    net = Net(state_shape=space.shape, action_shape=actions.n, hidden_sizes=(128, 128))
    policy = DiscreteQLearningPolicy(model=net, action_space=actions, observation_space=space, eps_training=0.1)
    # An agent's reward comes with the last agent's turn.
    dqn = DQN(
        policy=policy,
        optim=AdamOptimizerFactory(lr=5e-4),
        gamma=0.98 ** (1 / NUM_AGENTS),
        n_step_return_horizon=NUM_AGENTS,
        target_update_freq=200,
    )
    algorithm = MultiAgentOffPolicyAlgorithm(algorithms=[dqn] * NUM_AGENTS, env=env)
    envs = DummyVectorEnv([make_env] * 8)
    envs.seed(0)
    collector = Collector[object](algorithm, envs, VectorReplayBuffer(20_000, 8))
    collector.reset()
    algorithm.run_training(
        OffPolicyTrainerParams(
            training_collector=collector,
            max_epochs=1,
            epoch_num_steps=steps,
            collection_step_num_env_steps=64,
            update_step_num_gradient_steps_per_sample=1 / 16,
            batch_size=128,
            multi_agent_return_reduction=lambda returns: returns.mean(axis=1),
            show_progress=False,
            verbose=False,
        )
    )

    unseen, solved = FlatObservations(mapf_pz.parallel_env(source=MAPS, max_steps=32, **mapf_pz.RECOMMENDED)), []
    for seed in range(1_000_000, 1_000_050):
        observations, infos = unseen.reset(seed=seed)
        while unseen.agents:
            with torch.no_grad():
                values = net(np.array(list(observations.values())))[0].numpy()
            masks = np.array([infos[agent]["action_mask"] for agent in observations])
            chosen = np.where(masks, values, -np.inf).argmax(axis=1)
            observations, _, _, _, infos = unseen.step(dict(zip(observations, chosen.tolist(), strict=True)))
        solved.append(unseen.metrics()["CSR"])
    print(f"CSR on {len(solved)} unseen maps: {np.mean(solved):.2f}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 60_000)
