"""Train MAPPO of skrl, with one policy for all agents: `pip install skrl==2.1.1`."""

# pyright: reportMissingImports=false, reportUntypedBaseClass=false

import sys
from typing import Any

import numpy as np
import torch
from skrl.envs.wrappers.torch import wrap_env
from skrl.memories.torch import RandomMemory
from skrl.models.torch import CategoricalMixin, DeterministicMixin, Model
from skrl.multi_agents.torch.mappo import MAPPO, MAPPO_CFG
from skrl.trainers.torch import SequentialTrainer
from skrl.utils import set_seed
from torch import nn

import mapf_pz


def layers(inputs: int, outputs: int) -> nn.Sequential:
    """Return a network with two hidden layers."""
    return nn.Sequential(nn.Linear(inputs, 128), nn.ReLU(), nn.Linear(128, 128), nn.ReLU(), nn.Linear(128, outputs))


class Policy(CategoricalMixin, Model):
    """The policy, which observes what an agent does."""

    def __init__(self, **spaces: object) -> None:
        """Build the network."""
        Model.__init__(self, **spaces)
        CategoricalMixin.__init__(self)
        self.layers = layers(self.num_observations, self.num_actions)

    def compute(self, inputs: dict[str, torch.Tensor], _role: str) -> tuple[torch.Tensor, dict[str, object]]:
        """Return the logits of the actions."""
        return self.layers(inputs["observations"]), {}


class Value(DeterministicMixin, Model):
    """The critic, which also observes the global state."""

    def __init__(self, **spaces: object) -> None:
        """Build the network."""
        Model.__init__(self, **spaces)
        DeterministicMixin.__init__(self)
        self.layers = layers(self.num_observations + self.num_states, 1)

    def compute(self, inputs: dict[str, torch.Tensor], _role: str) -> tuple[torch.Tensor, dict[str, object]]:
        """Return the values."""
        return self.layers(torch.cat([inputs["observations"], inputs["states"]], dim=1)), {}


def main(steps: int) -> None:
    """Train four agents on random maps, and print the CSR of episodes on others."""
    torch.set_num_threads(1)
    set_seed(0)
    maps = mapf_pz.RandomObstacles(height=8, width=8, density=0.1, num_agents=4)
    env = wrap_env(mapf_pz.parallel_env(source=maps, max_steps=32, **mapf_pz.RECOMMENDED), wrapper="pettingzoo")
    name, agents = env.possible_agents[0], env.possible_agents
    spaces = {
        "observation_space": env.observation_space(name),
        "state_space": env.state_space(name),
        "action_space": env.action_space(name),
    }
    networks = {"policy": Policy(**spaces), "value": Value(**spaces)}
    kwargs = ("learning_rate_scheduler", "observation_preprocessor", "state_preprocessor", "value_preprocessor")
    config = MAPPO_CFG(
        rollouts=256,
        learning_epochs=4,
        mini_batches=4,
        discount_factor=0.98,
        learning_rate=7e-4,
        entropy_loss_scale=0.01,
        **{f"{part}_kwargs": {agent: {} for agent in agents} for part in kwargs},  # skrl refuses its own defaults
    )
    config.experiment.write_interval = config.experiment.checkpoint_interval = 0
    learner = MAPPO(
        possible_agents=agents,
        models=dict.fromkeys(agents, networks),
        memories={agent: RandomMemory(memory_size=256) for agent in agents},
        observation_spaces=env.observation_spaces,
        state_spaces=env.state_spaces,
        action_spaces=env.action_spaces,
        device="cpu",
        cfg=config,
    )
    SequentialTrainer(
        env=env, agents=learner, cfg={"timesteps": steps, "headless": True, "disable_progressbar": True}
    ).train()

    unseen, solved = mapf_pz.parallel_env(**env.unwrapped.config.keywords()), []
    for seed in range(1_000_000, 1_000_050):
        observations, _ = unseen.reset(seed=seed)
        while unseen.agents:
            seen: list[Any] = list(observations.values())
            rows = [np.concatenate([one["features"], one["image"].ravel()]) for one in seen]
            actions, _ = networks["policy"].act({"observations": torch.from_numpy(np.array(rows))}, role="policy")
            observations, *_ = unseen.step(dict(zip(observations, actions.flatten().tolist(), strict=True)))
        solved.append(unseen.metrics()["CSR"])
    print(f"CSR on {len(solved)} unseen maps: {np.mean(solved):.2f}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 20_000)
