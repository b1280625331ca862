"""What an algorithm is: the form of the environment, an actor and a loss, put together from TorchRL's parts.

No loops live here: `mapf_pz.rl.train` runs the same loop for all algorithms.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar

from tensordict import NestedKey
from tensordict.nn import TensorDictModule
from torch import nn
from torch.distributions import Categorical
from torchrl.envs import Transform
from torchrl.modules import IndependentNormal, ProbabilisticActor
from torchrl.objectives import ClipPPOLoss, IPPOLoss, MAPPOLoss, PPOLoss, ValueEstimators

from mapf_pz.observation import ObservationLayout
from mapf_pz.rl.centralize import Centralize
from mapf_pz.rl.config import AlgorithmName, PPOConfig, TrainConfig
from mapf_pz.rl.models import Actor, LocalCritic, TeamActor, TeamCritic, TeamValue


class Algorithm(ABC):
    """What the training loop needs to know, for the observations of `layout`."""

    reward_key: ClassVar[NestedKey]
    """Where the reward is that the loss learns from."""

    def __init__(self, layout: ObservationLayout, config: TrainConfig) -> None:
        """Build the networks and the loss."""
        self.layout = layout
        self.config = config
        self.network = self.make_network(layout, config)
        """What is saved as the policy."""
        self.actor = self.make_actor()
        """What acts while data is collected."""
        self.loss = self.make_loss()
        """What is minimized; its estimator bootstraps truncated episodes, and terminated ones not."""

    @staticmethod
    @abstractmethod
    def make_network(layout: ObservationLayout, config: TrainConfig) -> nn.Module:
        """Return the policy's network with fresh weights."""

    @abstractmethod
    def make_actor(self) -> ProbabilisticActor:
        """Return the policy that draws actions."""

    @abstractmethod
    def make_loss(self) -> PPOLoss:
        """Return the loss, with the critic and the estimator of advantages."""

    def transforms(self) -> list[Transform]:
        """Return what brings the environment into the form that the actor acts in."""
        return []


class MultiAgentPPO(Algorithm):
    """Each agent acts by itself, all with one network; what the critic sees tells the algorithms apart."""

    reward_key = ("agents", "reward")
    critic: ClassVar[type[nn.Module]]
    loss_class: ClassVar[type[MAPPOLoss]]

    @staticmethod
    def make_network(layout: ObservationLayout, config: TrainConfig) -> Actor:
        """Return a network that works with any number of agents."""
        return Actor(layout.image_shape, layout.num_features, layout.num_actions, config.model)

    def make_actor(self) -> ProbabilisticActor:
        """Return the policy that draws each agent's action from the network's logits."""
        return ProbabilisticActor(
            TensorDictModule(self.network, in_keys=self._observed(), out_keys=[("agents", "logits")]),
            in_keys=[("agents", "logits")],
            out_keys=[("agents", "action")],
            distribution_class=Categorical,
            return_log_prob=True,
        )

    def make_loss(self) -> PPOLoss:
        """Return TorchRL's loss."""
        network = self.critic(self.layout.image_shape, self.layout.num_features, self.config.model)
        critic = TensorDictModule(network, in_keys=self._observed(), out_keys=[("agents", "state_value")])
        loss = self.loss_class(self.actor, critic, **_coefficients(self.config.ppo))
        loss.set_keys(
            value=("agents", "state_value"),
            action=("agents", "action"),
            reward=self.reward_key,
            sample_log_prob=("agents", "action_log_prob"),
        )
        loss.make_value_estimator(ValueEstimators.MAGAE, gamma=self.config.ppo.gamma, lmbda=self.config.ppo.lmbda)
        return loss

    def _observed(self) -> list[NestedKey]:
        if self.layout.num_features:
            return [("agents", "observation", "image"), ("agents", "observation", "features")]
        return [("agents", "observation")]


class MAPPO(MultiAgentPPO):
    """The critic sees the team (Yu et al., *The Surprising Effectiveness of PPO in Multi-Agent Games*, 2022)."""

    critic = TeamCritic
    loss_class = MAPPOLoss


class IPPO(MultiAgentPPO):
    """The critic sees what the agent sees (de Witt et al., *Is Independent Learning All You Need*, 2020)."""

    critic = LocalCritic
    loss_class = IPPOLoss


class CentralPPO(Algorithm):
    """The report's single policy: all agents' observations stacked, and a matrix of N x A numbers as the action."""

    reward_key = ("team", "reward")

    @staticmethod
    def make_network(layout: ObservationLayout, config: TrainConfig) -> TeamActor:
        """Return a network for exactly the number of agents that it is trained with."""
        num_agents = config.task.num_agents
        return TeamActor(layout.image_shape, layout.num_features, layout.num_actions, num_agents, config.model)

    def transforms(self) -> list[Transform]:
        """Return the step to the centralized form."""
        return [Centralize(self.layout.num_actions, self.config.task.action_mode, self.config.seed)]

    def make_actor(self) -> ProbabilisticActor:
        """Return the policy that draws the matrix from a normal distribution with a learned, common spread."""
        parameters: list[NestedKey] = [("team", "loc"), ("team", "scale")]
        return ProbabilisticActor(
            TensorDictModule(self.network, in_keys=self._observed(), out_keys=parameters),
            in_keys=parameters,
            out_keys=[("team", "action")],
            distribution_class=IndependentNormal,
            distribution_kwargs={"tanh_loc": False},
            return_log_prob=True,
        )

    def make_loss(self) -> PPOLoss:
        """Return TorchRL's loss."""
        layout, config = self.layout, self.config
        network = TeamValue(layout.image_shape, layout.num_features, config.task.num_agents, config.model)
        critic = TensorDictModule(network, in_keys=self._observed(), out_keys=[("team", "state_value")])
        loss = ClipPPOLoss(self.actor, critic, **_coefficients(config.ppo))
        loss.set_keys(
            value=("team", "state_value"),
            action=("team", "action"),
            reward=self.reward_key,
            sample_log_prob=("team", "action_log_prob"),
        )
        loss.make_value_estimator(ValueEstimators.GAE, gamma=config.ppo.gamma, lmbda=config.ppo.lmbda)
        return loss

    def _observed(self) -> list[NestedKey]:
        keys: list[NestedKey] = [("team", "image"), ("team", "features")]
        return keys if self.layout.num_features else keys[:1]


ALGORITHMS: dict[AlgorithmName, type[Algorithm]] = {"mappo": MAPPO, "ippo": IPPO, "central-ppo": CentralPPO}
"""The algorithms by name."""


def _coefficients(ppo: PPOConfig) -> dict[str, Any]:
    return {
        "clip_epsilon": ppo.clip_epsilon,
        "entropy_coeff": ppo.entropy_coeff,
        "critic_coeff": ppo.critic_coeff,
        "normalize_advantage": True,
    }
