"""Proximal policy optimization: algorithms from TorchRL's losses, actors and advantage estimators."""

from __future__ import annotations

import copy
from abc import abstractmethod
from typing import Any, ClassVar, cast

from tensordict import NestedKey
from tensordict.nn import TensorDictModule, TensorDictModuleBase, TensorDictSequential
from torch import nn
from torch.distributions import Categorical
from torchrl.envs import Transform
from torchrl.modules import IndependentNormal, MaskedCategorical, ProbabilisticActor
from torchrl.objectives import ClipPPOLoss, IPPOLoss, MAPPOLoss, PPOLoss, ValueEstimators

from mapf_pz.rl.algorithms.algorithm import Algorithm
from mapf_pz.rl.algorithms.ppo_learner import PPOKeys, PPOLearner
from mapf_pz.rl.config import PPOConfig, TrainConfig
from mapf_pz.rl.environments.centralize import Centralize
from mapf_pz.rl.environments.execution import ExecutePreferences, OrderActions
from mapf_pz.rl.networks.actors import (
    Actor,
    LocalCritic,
    MatrixActor,
    TeamCritic,
    add_recurrence,
    make_matrix_actor,
    make_team_value,
)
from mapf_pz.rl.networks.observation_shape import ObservationShape


class PPOAlgorithm(Algorithm):
    """Base class of algorithms with an actor, a critic and a reward."""

    reward_key: NestedKey = ("agents", "reward")
    """Key of the reward that the loss uses."""
    action_key: ClassVar[NestedKey] = ("agents", "action")
    """Key of the discrete action that each agent took."""
    policy: ProbabilisticActor
    """The network and the distribution of actions, as the loss uses them."""

    def __init__(self, config: TrainConfig) -> None:
        """Build the networks and the loss."""
        super().__init__(config)
        self.loss = self.make_loss()
        """The loss; its value estimator bootstraps truncated episodes, but not terminated ones."""
        self.initial: nn.Module | None = None
        """The network that the run started from, if `kl_coeff` needs it."""

    @abstractmethod
    def make_policy(self) -> ProbabilisticActor:
        """Return the network and the distribution of actions."""

    def make_actor(self) -> TensorDictModuleBase:
        """Return the policy."""
        self.policy = self.make_policy()
        return self.policy

    def start_from(self, network: nn.Module) -> None:
        """Start from the weights of a network, as in `Algorithm`, and keep a copy of it if `kl_coeff` needs it."""
        super().start_from(network)
        if self.config.ppo.kl_coeff > 0:
            self.initial = copy.deepcopy(network).requires_grad_(False)

    @abstractmethod
    def make_loss(self) -> PPOLoss:
        """Return the loss, with its critic and its advantage estimator."""

    def make_learner(self) -> PPOLearner:
        """Return the learner of the loss."""
        keys = PPOKeys(self.reward_key, self.action_key, self.observation_keys())
        return PPOLearner(self.config, self.loss, keys, self.agents_end, self.initial)

    @property
    def agents_end(self) -> bool:
        """Whether an agent's episode ends when it disappears: with `on_target="finish"` and a reward per agent."""
        return self.config.task.env.on_target == "finish" and self.reward_key == ("agents", "reward")

    def _end_keys(self) -> dict[str, NestedKey]:
        """Return the loss's keys of the per-agent `done` and `terminated`, which `PPOLearner.learn` sets."""
        return {"done": ("agents", "done"), "terminated": ("agents", "terminated")} if self.agents_end else {}


class MultiAgentPPO(PPOAlgorithm):
    """Each agent acts by itself, and all share one network; the algorithms differ in what the critic observes."""

    critic: ClassVar[type[LocalCritic | TeamCritic]]
    loss_class: ClassVar[type[MAPPOLoss]]

    def make_policy(self) -> ProbabilisticActor:
        """Return the policy that samples each agent's action from the network's logits, masked if configured."""
        masked = self.config.model.mask_actions
        parameters: dict[str, NestedKey] = {"logits": ("agents", "logits")}
        if masked:
            parameters["mask"] = ("agents", "action_mask")
        return ProbabilisticActor(
            self.network_module(),
            in_keys=cast("Any", parameters),  # annotated as a list of keys
            out_keys=[("agents", "action")],
            distribution_class=MaskedCategorical if masked else Categorical,
            return_log_prob=True,
        )

    def make_actor(self) -> TensorDictModuleBase:
        """Return the policy; with the safety layer, it also returns the order of the actions."""
        policy = super().make_actor()
        if not self.config.task.shield:
            return policy
        in_keys: list[NestedKey] = [("agents", "logits"), ("agents", "action")]
        order = TensorDictModule(OrderActions(), in_keys, [("agents", "preferences")])
        modules: list[Any] = [policy, order]
        return TensorDictSequential(*modules)

    def transforms(self, seed: int) -> list[Transform]:
        """Return the transforms; with the safety layer, the last one executes the order of the actions."""
        transforms = super().transforms(seed)
        return [*transforms, ExecutePreferences()] if self.config.task.shield else transforms

    def make_loss(self) -> PPOLoss:
        """Return TorchRL's loss."""
        network = self.critic(self.observation_shape, self.config.model)
        critic = TensorDictModule(network, in_keys=self.observation_keys(), out_keys=[("agents", "state_value")])
        loss = self.loss_class(self.policy, critic, **_coefficients(self.config.ppo))
        loss.set_keys(
            value=("agents", "state_value"),
            action=("agents", "action"),
            reward=self.reward_key,
            sample_log_prob=("agents", "action_log_prob"),
            **self._end_keys(),
        )
        loss.make_value_estimator(ValueEstimators.MAGAE, **_estimation(self.config.ppo))
        return loss


class MAPPO(MultiAgentPPO):
    """The critic observes the team (Yu et al., *The Surprising Effectiveness of PPO in Multi-Agent Games*, 2022)."""

    critic = TeamCritic
    loss_class = MAPPOLoss


class IPPO(MultiAgentPPO):
    """The critic observes what the agent observes (de Witt et al., *Is Independent Learning All You Need*, 2020)."""

    critic = LocalCritic
    loss_class = IPPOLoss


class CentralPPO(PPOAlgorithm):
    """The report's single policy: it observes all agents, and its action is an N x A matrix.

    Without communication, it observes the agents' stacked observations, as in the report, so the size of its network
    grows with N. With communication, it is one network for any N.

    With `credit="team"` the matrix is one action with one advantage, computed from the mean reward. With
    `credit="agent"` each row has a separate advantage, computed from its agent's reward: the policy is the same product
    of distributions, but one agent's reward no longer adds noise to the credit of another agent's action.
    """

    parameters: ClassVar[list[NestedKey]] = [("team", "loc"), ("team", "scale")]
    action_key = ("next", "agents", "taken")
    centralized = True

    def __init__(self, config: TrainConfig) -> None:
        """Build the networks and the loss; raises `ValueError` with `mask_actions`."""
        if config.model.mask_actions:
            raise ValueError("mask_actions: expected False with central-ppo, whose actions are real numbers")
        if config.task.shield:
            raise ValueError("shield: expected False with central-ppo, whose actions are real numbers")
        self._each = config.ppo.credit == "agent"
        self.reward_key = ("agents", "reward") if self._each else ("team", "reward")
        super().__init__(config)

    @staticmethod
    def make_network(config: TrainConfig) -> nn.Module:
        """Return a network; without communication it is for exactly the number of agents in the configuration."""
        shape = ObservationShape.of_task(config.task)
        return add_recurrence(make_matrix_actor(shape, config.task.num_agents, config.model), config.model)

    def start_from(self, network: nn.Module) -> None:
        """Start from the weights of a network, as in `Algorithm`; with communication, also of one of logits."""
        if isinstance(self.network, MatrixActor) and type(network) is Actor:
            network.log_scale = self.network.log_scale
        super().start_from(network)

    @classmethod
    def fixed_num_agents(cls, config: TrainConfig) -> int | None:
        """Return N, as in training; None with communication."""
        return None if config.model.communication else config.task.num_agents

    @staticmethod
    def num_hidden_states(config: TrainConfig) -> int:
        """Return 1: the team has a single hidden state; with communication, each agent has its own."""
        return config.task.num_agents if config.model.communication else 1

    def transforms(self, seed: int) -> list[Transform]:
        """Return the transforms, followed by the one that centralizes the environment."""
        return [
            *super().transforms(seed),
            Centralize(self.observation_shape.actions, self.config.task.action_mode, seed),
        ]

    def make_policy(self) -> ProbabilisticActor:
        """Return the policy that samples the matrix from normal distributions with learned, constant scales."""
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
        network = make_team_value(self.observation_shape, config.task.num_agents, config.ppo.credit, config.model)
        critic = TensorDictModule(network, in_keys=self.observation_keys(), out_keys=[("team", "state_value")])
        loss_class = MAPPOLoss if self._each else ClipPPOLoss
        loss = loss_class(self.policy, critic, **_coefficients(config.ppo))
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

    def observation_keys(self) -> list[NestedKey]:
        """Return the keys of the team's image and features; with communication, those of the agents'."""
        if self.config.model.communication:
            return super().observation_keys()
        keys: list[NestedKey] = [("team", "image"), ("team", "features")]
        return keys if self.observation_shape.features else keys[:1]


def _coefficients(ppo: PPOConfig) -> dict[str, Any]:
    return {
        "clip_epsilon": ppo.clip_epsilon,
        "entropy_coeff": ppo.entropy_coeff,
        "critic_coeff": ppo.critic_coeff,
        "normalize_advantage": True,
    }


def _estimation(ppo: PPOConfig) -> dict[str, Any]:
    # Without vmap: vectorized over values and next values, the convolutions take four times as long.
    return {"gamma": ppo.gamma, "lmbda": ppo.lmbda, "deactivate_vmap": True}
