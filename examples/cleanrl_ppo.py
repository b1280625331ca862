"""Proximal policy optimization in one file, as CleanRL writes it: plain PyTorch on `AgentVectorEnv`.

All agents share the policy's parameters, so each of them is an environment to the algorithm. The task is that of
`mapf-pz train quickstart`: eight agents on random 12 x 12 maps.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
import tyro
from gymnasium import spaces
from torch import Tensor, nn
from torch.distributions import Categorical

import mapf_pz
from mapf_pz import RandomObstacles
from mapf_pz.wrappers import AgentVectorEnv

FORBIDDEN = -1e8
"""Logit of actions that the map does not allow."""


@dataclass(frozen=True)
class Example:
    """Eight agents on random 12 x 12 maps."""

    agent_steps: int = 1_000_000
    """Length of training in agent steps."""
    num_envs: int = 16
    """Number of environments, each with eight agents."""
    steps_per_batch: int = 64
    """Number of steps of each agent between two updates."""
    num_epochs: int = 4
    """Number of passes over each batch."""
    minibatch_size: int = 1024
    """Number of agent steps in a gradient step."""
    learning_rate: float = 1e-3
    """Learning rate of Adam at the start; it falls to zero."""
    gamma: float = 0.98
    """Discount factor."""
    gae_lambda: float = 0.95
    """Factor of generalized advantage estimation."""
    clip: float = 0.2
    """Maximum relative change of an action's probability that is rewarded."""
    entropy_coeff: float = 0.01
    """Weight of the entropy."""
    episodes: int = 50
    """Number of evaluation episodes."""
    seed: int = 0
    """Random seed of weights, exploration and instances."""


class Policy(nn.Module):
    """Logits and the value of each agent's observation."""

    def __init__(self, envs: AgentVectorEnv) -> None:
        """Create the layers for the environments' images, features and actions."""
        super().__init__()
        num_inputs, num_actions = spaces.flatdim(envs.single_observation_space), envs.simulator.num_actions
        self.trunk = nn.Sequential(nn.Linear(num_inputs, 256), nn.Tanh(), nn.Linear(256, 128), nn.Tanh())
        self.actor, self.critic = nn.Linear(128, num_actions), nn.Linear(128, 1)
        nn.init.orthogonal_(self.actor.weight, 0.01)

    def forward(self, inputs: Tensor, mask: Tensor) -> tuple[Categorical, Tensor]:
        """Return the distribution of actions and the values (M,) of M observations."""
        hidden = self.trunk(inputs)
        logits = self.actor(hidden).masked_fill(~mask, FORBIDDEN)
        return Categorical(logits=logits), self.critic(hidden)[:, 0]


def make_envs(num_envs: int) -> AgentVectorEnv:
    """Return the environments: a new map for each episode."""
    maps = RandomObstacles(height=12, width=12, density=0.3, num_agents=8)
    return AgentVectorEnv(num_envs, source=maps, max_steps=96, **mapf_pz.RECOMMENDED)


def tensors(observations: Any, infos: dict[str, Any]) -> tuple[Tensor, Tensor]:
    """Return the flattened images and features, and the action masks."""
    image, features = (torch.from_numpy(observations[name]) for name in ("image", "features"))
    return torch.cat([image.flatten(1), features], 1), torch.from_numpy(infos["action_mask"]).bool()


class Trainer:
    """A policy, its environments and its optimizer."""

    def __init__(self, example: Example) -> None:
        """Create them."""
        torch.manual_seed(example.seed)
        self.example = example
        self.envs = make_envs(example.num_envs)
        self.policy = Policy(self.envs)
        self.optimizer = torch.optim.Adam(self.policy.parameters(), lr=example.learning_rate, eps=1e-5)
        self.observations, self.infos = self.envs.reset(seed=example.seed)
        self.solved: list[float] = []

    def batch(self) -> dict[str, Tensor]:
        """Return a batch of steps (T, M) of M agents, with advantages and returns."""
        steps: list[dict[str, Tensor]] = []
        with torch.no_grad():
            for _ in range(self.example.steps_per_batch):
                inputs, mask = tensors(self.observations, self.infos)
                distribution, values = self.policy(inputs, mask)
                actions = distribution.sample()
                active = torch.from_numpy(self.infos["active"])
                self.observations, rewards, terminated, truncated, self.infos = self.envs.step(actions.numpy())
                if "CSR" in self.infos:
                    # A team's metrics are those of each of its agents.
                    self.solved += self.infos["CSR"][self.infos["_CSR"]][:: self.envs.simulator.num_agents].tolist()
                steps.append(
                    {
                        "inputs": inputs,
                        "mask": mask,
                        "actions": actions,
                        "log_prob": distribution.log_prob(actions),
                        "values": values,
                        "active": active,
                        "rewards": torch.from_numpy(rewards).float(),
                        "terminated": torch.from_numpy(terminated),
                        "ended": torch.from_numpy(terminated | truncated),
                    }
                )
            last = self.policy(*tensors(self.observations, self.infos))[1]
        batch = {name: torch.stack([step[name] for step in steps]) for name in steps[0]}
        batch["advantages"] = self.advantages(batch, last)
        return batch | {"returns": batch["advantages"] + batch["values"]}

    def advantages(self, batch: dict[str, Tensor], last: Tensor) -> Tensor:
        """Return generalized advantage estimates (T, M); `last` (M,) are the values after the last step.

        The observation after a step that truncates an episode is the last one of that episode, so its value counts.
        """
        following = torch.cat([batch["values"][1:], last[None]])
        targets = batch["rewards"] + self.example.gamma * following * ~batch["terminated"]
        advantages = targets - batch["values"]
        decay = self.example.gamma * self.example.gae_lambda * ~batch["ended"]
        for t in reversed(range(len(advantages) - 1)):
            advantages[t] += decay[t] * advantages[t + 1]
        return advantages

    def update(self, batch: dict[str, Tensor]) -> None:
        """Take gradient steps on the agent steps of a batch in which the action was used."""
        used = {name: part[batch["active"]] for name, part in batch.items()}
        for _ in range(self.example.num_epochs):
            for rows in torch.randperm(len(used["actions"])).split(self.example.minibatch_size):
                self.optimizer.zero_grad()
                self.loss({name: part[rows] for name, part in used.items()}).backward()
                nn.utils.clip_grad_norm_(self.policy.parameters(), 0.5)
                self.optimizer.step()

    def loss(self, part: dict[str, Tensor]) -> Tensor:
        """Return the loss of a minibatch."""
        distribution, values = self.policy(part["inputs"], part["mask"])
        ratio = (distribution.log_prob(part["actions"]) - part["log_prob"]).exp()
        advantages = (part["advantages"] - part["advantages"].mean()) / (part["advantages"].std() + 1e-8)
        clipped = ratio.clamp(1 - self.example.clip, 1 + self.example.clip)
        policy_loss = -torch.min(ratio * advantages, clipped * advantages).mean()
        value_loss = 0.5 * (values - part["returns"]).square().mean()
        return policy_loss + value_loss - self.example.entropy_coeff * distribution.entropy().mean()

    def train(self) -> None:
        """Train for all agent steps, and print the share of solved episodes ten times."""
        example = self.example
        steps = example.steps_per_batch * self.envs.num_envs
        num_updates = max(1, example.agent_steps // steps)
        for update in range(num_updates):
            for group in self.optimizer.param_groups:
                group["lr"] = example.learning_rate * (1 - update / num_updates)
            self.update(self.batch())
            if (update + 1) % max(1, num_updates // 10) == 0:
                print(f"{(update + 1) * steps:8} agent steps: CSR {np.mean(self.solved or [0]):.2f}", flush=True)
                self.solved.clear()


def evaluate(policy: Policy, example: Example) -> float:
    """Return the CSR of sampled actions on unseen maps with 15 % obstacles."""
    maps = RandomObstacles(height=12, width=12, density=0.15, num_agents=8)
    env = AgentVectorEnv(1, source=maps, max_steps=96, autoreset_mode="SameStep", **mapf_pz.RECOMMENDED)
    solved: list[float] = []
    observations, infos = env.reset(seed=1_000_000 + example.seed)
    while len(solved) < example.episodes:
        with torch.no_grad():
            actions = policy(*tensors(observations, infos))[0].sample()
        observations, _, _, _, infos = env.step(actions.numpy())
        if "final_info" in infos:
            solved.append(float(infos["final_info"]["CSR"][0]))
    return float(np.mean(solved))


def main(example: Example) -> None:
    """Train and evaluate the policy."""
    torch.set_num_threads(1)  # several threads are slower for a network this small, above all where cores are busy
    trainer = Trainer(example)
    trainer.train()
    print(f"CSR on {example.episodes} unseen maps: {evaluate(trainer.policy, example):.2f}")


if __name__ == "__main__":
    main(tyro.cli(Example))
