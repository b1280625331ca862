"""What an algorithm is: the form of the environment, an actor and a loss, put together from TorchRL's parts.

No loops live here: `mapf_pz.rl.train` runs the same loop for all algorithms.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar, cast

import torch
from tensordict import NestedKey
from tensordict.nn import TensorDictModule
from torch import nn
from torch.distributions import Categorical
from torchrl.data import Unbounded
from torchrl.envs import InitTracker, TensorDictPrimer, Transform
from torchrl.modules import IndependentNormal, ProbabilisticActor
from torchrl.objectives import ClipPPOLoss, IPPOLoss, MAPPOLoss, PPOLoss, ValueEstimators

from mapf_pz.plugins import import_subclass
from mapf_pz.rl.centralize import Centralize
from mapf_pz.rl.config import AlgorithmName, PPOConfig, TrainConfig
from mapf_pz.rl.networks import Actor, LocalCritic, TeamActor, TeamCritic, TeamValue, with_memory
from mapf_pz.rl.observed import Observed, observation_transforms


class Algorithm(ABC):
    """What the training loop needs to know."""

    reward_key: NestedKey
    """Where the reward is that the loss learns from."""
    parameters: ClassVar[list[NestedKey]]
    """Keys of the parameters of the action distribution."""
    action_key: ClassVar[NestedKey] = ("agents", "action")
    """Key of the discrete action that each agent took."""
    centralized: ClassVar[bool] = False
    """Whether one policy acts for exactly the agents that it is trained with, not each agent for itself."""

    def __init__(self, config: TrainConfig) -> None:
        """Build the networks and the loss."""
        self.config = config
        self.observed = Observed.by_policy_of(config.task)
        self.network = self.make_network(config)
        """What is saved as the policy."""
        self.actor = self.make_actor()
        """What acts while data is collected."""
        self.loss = self.make_loss()
        """What is minimized; its estimator bootstraps truncated episodes, and terminated ones not."""

    @staticmethod
    @abstractmethod
    def make_network(config: TrainConfig) -> nn.Module:
        """Return the policy's network with fresh weights."""

    @abstractmethod
    def make_actor(self) -> ProbabilisticActor:
        """Return the policy that draws actions."""

    @abstractmethod
    def make_loss(self) -> PPOLoss:
        """Return the loss, with the critic and the estimator of advantages."""

    @abstractmethod
    def observed_keys(self) -> list[NestedKey]:
        """Return where the image is, and the features if there are any."""

    @property
    def agents_end(self) -> bool:
        """Whether each agent's episode ends when the agent leaves: with `on_target="finish"` and a reward per agent."""
        return self.config.task.env.on_target == "finish" and self.reward_key == ("agents", "reward")

    def _end_keys(self) -> dict[str, NestedKey]:
        """Return the loss's keys of each agent's own `done` and `terminated`, which `Learner.learn` sets."""
        return {"done": ("agents", "done"), "terminated": ("agents", "terminated")} if self.agents_end else {}

    @staticmethod
    def num_memories(config: TrainConfig) -> int:
        """Return how many memories there are in an environment: one per agent."""
        return config.task.num_agents

    def transforms(self, seed: int) -> list[Transform]:
        """Return what brings the environment into the form that the actor acts in; `seed` is of what it draws."""
        transforms = observation_transforms(self.config.task)
        size = self.config.model.recurrent
        if size == 0:
            return transforms
        memory = Unbounded(shape=torch.Size([self.num_memories(self.config), size]))
        return [*transforms, InitTracker(), TensorDictPrimer({"memory": memory}, expand_specs=True)]

    def network_module(self) -> TensorDictModule:
        """Return the network with the keys that it reads and writes; a memory is handed from step to step."""
        if self.config.model.recurrent == 0:
            return TensorDictModule(self.network, in_keys=self.observed_keys(), out_keys=self.parameters)
        in_keys: list[NestedKey] = ["memory", "is_init", *self.observed_keys()]
        return TensorDictModule(self.network, in_keys=in_keys, out_keys=[*self.parameters, ("next", "memory")])


class MultiAgentPPO(Algorithm):
    """Each agent acts by itself, all with one network; what the critic sees tells the algorithms apart."""

    reward_key = ("agents", "reward")
    parameters: ClassVar[list[NestedKey]] = [("agents", "logits")]
    critic: ClassVar[type[LocalCritic | TeamCritic]]
    loss_class: ClassVar[type[MAPPOLoss]]

    @staticmethod
    def make_network(config: TrainConfig) -> nn.Module:
        """Return a network that works with any number of agents."""
        return with_memory(Actor(Observed.by_policy_of(config.task), config.model), config.model)

    def make_actor(self) -> ProbabilisticActor:
        """Return the policy that draws each agent's action from the network's logits."""
        return ProbabilisticActor(
            self.network_module(),
            in_keys=self.parameters,
            out_keys=[("agents", "action")],
            distribution_class=Categorical,
            return_log_prob=True,
        )

    def make_loss(self) -> PPOLoss:
        """Return TorchRL's loss."""
        network = self.critic(self.observed, self.config.model)
        critic = TensorDictModule(network, in_keys=self.observed_keys(), out_keys=[("agents", "state_value")])
        loss = self.loss_class(self.actor, critic, **_coefficients(self.config.ppo))
        loss.set_keys(
            value=("agents", "state_value"),
            action=("agents", "action"),
            reward=self.reward_key,
            sample_log_prob=("agents", "action_log_prob"),
            **self._end_keys(),
        )
        loss.make_value_estimator(ValueEstimators.MAGAE, **_estimation(self.config.ppo))
        return loss

    def observed_keys(self) -> list[NestedKey]:
        """Return each agent's."""
        if self.observed.features:
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
    """The report's single policy: all agents' observations stacked, and a matrix of N x A numbers as the action.

    With `credit="team"` the matrix is one action with one advantage, from the mean reward. With `credit="agent"` each
    row has an advantage of its own, from its agent's reward: the policy is the same product of distributions, but what
    one agent earns no longer blurs what another has done.
    """

    parameters: ClassVar[list[NestedKey]] = [("team", "loc"), ("team", "scale")]
    action_key = ("next", "agents", "taken")
    centralized = True

    def __init__(self, config: TrainConfig) -> None:
        """Build the networks and the loss."""
        self._each = config.ppo.credit == "agent"
        self.reward_key = ("agents", "reward") if self._each else ("team", "reward")
        super().__init__(config)

    @staticmethod
    def make_network(config: TrainConfig) -> nn.Module:
        """Return a network for exactly the number of agents that it is trained with."""
        actor = TeamActor(Observed.by_policy_of(config.task), config.task.num_agents, config.model)
        return with_memory(actor, config.model)

    @staticmethod
    def num_memories(config: TrainConfig) -> int:
        """Return 1: the team's."""
        return 1

    def transforms(self, seed: int) -> list[Transform]:
        """Return the step to the centralized form."""
        return [*super().transforms(seed), Centralize(self.observed.actions, self.config.task.action_mode, seed)]

    def make_actor(self) -> ProbabilisticActor:
        """Return the policy that draws the matrix from a normal distribution with a learned, common spread."""
        return ProbabilisticActor(
            self.network_module(),
            in_keys=self.parameters,
            out_keys=[("team", "action")],
            distribution_class=IndependentNormal,
            distribution_kwargs={"tanh_loc": False, "event_dim": 1 if self._each else 2},
            return_log_prob=True,
        )

    def make_loss(self) -> PPOLoss:
        """Return TorchRL's loss."""
        config = self.config
        network = TeamValue(self.observed, config.task.num_agents, config.ppo.credit, config.model)
        critic = TensorDictModule(network, in_keys=self.observed_keys(), out_keys=[("team", "state_value")])
        loss_class = MAPPOLoss if self._each else ClipPPOLoss
        loss = loss_class(self.actor, critic, **_coefficients(config.ppo))
        loss.set_keys(
            value=("team", "state_value"),
            action=("team", "action"),
            reward=self.reward_key,
            sample_log_prob=("team", "action_log_prob"),
            **self._end_keys(),
        )
        estimator = ValueEstimators.MAGAE if self._each else ValueEstimators.GAE
        loss.make_value_estimator(estimator, **_estimation(config.ppo))
        return loss

    def observed_keys(self) -> list[NestedKey]:
        """Return the team's."""
        keys: list[NestedKey] = [("team", "image"), ("team", "features")]
        return keys if self.observed.features else keys[:1]


ALGORITHMS: dict[AlgorithmName, type[Algorithm]] = {"mappo": MAPPO, "ippo": IPPO, "central-ppo": CentralPPO}
"""The built-in algorithms by name."""


def algorithm_of(name: str) -> type[Algorithm]:
    """Return the algorithm that a configuration names; raises `ValueError` if `package.module:Class` is not one."""
    if ":" not in name:
        return ALGORITHMS[cast("AlgorithmName", name)]
    return import_subclass("algorithm", name, Algorithm)


def _coefficients(ppo: PPOConfig) -> dict[str, Any]:
    return {
        "clip_epsilon": ppo.clip_epsilon,
        "entropy_coeff": ppo.entropy_coeff,
        "critic_coeff": ppo.critic_coeff,
        "normalize_advantage": True,
    }


def _estimation(ppo: PPOConfig) -> dict[str, Any]:
    # A loop over values and next values: vectorized over both, the convolutions take four times as long.
    return {"gamma": ppo.gamma, "lmbda": ppo.lmbda, "deactivate_vmap": True}
