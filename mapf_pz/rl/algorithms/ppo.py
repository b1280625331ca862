"""Proximal policy optimization: its learner, and algorithms from TorchRL's losses, actors and advantage estimators."""

from __future__ import annotations

import copy
from abc import abstractmethod
from typing import Any, ClassVar, cast

import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase, TensorDictSequential
from torch import Tensor, nn
from torch.distributions import Categorical
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.data.replay_buffers.samplers import SamplerWithoutReplacement
from torchrl.envs import Transform
from torchrl.modules import IndependentNormal, MaskedCategorical, ProbabilisticActor
from torchrl.objectives import ClipPPOLoss, IPPOLoss, MAPPOLoss, PPOLoss, ValueEstimators
from torchrl.objectives.value import GAE

from mapf_pz.rl.algorithms.algorithm import Algorithm
from mapf_pz.rl.algorithms.curiosity import make_curiosity
from mapf_pz.rl.algorithms.learner import Learner
from mapf_pz.rl.config import PPOConfig, TrainConfig
from mapf_pz.rl.environments.centralize import Centralize
from mapf_pz.rl.environments.execution import ExecutePreferences, OrderActions
from mapf_pz.rl.environments.transfer import to_device
from mapf_pz.rl.networks.actors import (
    LocalCritic,
    TeamCritic,
    add_recurrence,
    make_matrix_actor,
    make_team_value,
)
from mapf_pz.rl.networks.observation_shape import ObservationShape

LOSS_MASK = "shifted_valid"
"""TorchRL's key of a mask: entries that are False are excluded from losses and from advantage normalization."""


class PPOLearner(Learner):
    """Proximal policy optimization (Schulman et al., 2017) of a loss, which contains the actor and the critic."""

    def __init__(self, algorithm: PPOAlgorithm) -> None:
        """Create the optimizer for the networks of the algorithm's loss, on their device.

        The loss's value estimator loses its value network, since the learner computes the values.
        """
        config = self.config = algorithm.config
        self.loss = algorithm.loss
        cast("GAE", self.loss.value_estimator).value_network = None  # it reads the values of `_set_values`
        self.curiosity = make_curiosity(config, algorithm.action_key)
        self._reward_key, self._observation_keys = algorithm.reward_key, algorithm.observation_keys()
        self._initial = algorithm.initial
        self._agents_end = algorithm.agents_end
        self.device = next(self.loss.parameters()).device
        self.modules = {"loss": self.loss}
        self._terms = self.compiled(self.loss)
        groups = [{"params": list(self.loss.parameters()), "initial_lr": config.optimization.learning_rate}]
        if self.curiosity is not None:
            self.modules["curiosity"] = self.curiosity.to(self.device)
            trained = [parameter for parameter in self.curiosity.parameters() if parameter.requires_grad]
            groups.append({"params": trained, "initial_lr": config.curiosity.learning_rate})
        self.optimizer = torch.optim.Adam(groups, eps=1e-5)
        self._minibatch_size = config.optimization.minibatch_size
        self._buffer = _make_buffer(config, self.device)

    def learn(self, batch: TensorDictBase, done: float) -> dict[str, float]:
        """Update the networks with a batch, as in `Learner`."""
        self.anneal(done)
        batch = to_device(batch, self.device)
        if self._agents_end:
            _set_agent_ends(batch)
        means: dict[str, Tensor] = {}
        if self.curiosity is not None:
            means["intrinsic_reward"] = self.curiosity.add_reward(batch, self._reward_key)
            self.ranks.average(list(self.curiosity.scale.statistics.buffers()))
        if self._initial is not None:
            means["kl_from_initial"] = self._penalize(batch, self._initial)
        with torch.no_grad():
            self._set_values(batch)
            self.loss.value_estimator(batch)
        if self._agents_end:
            batch.set(LOSS_MASK, batch.get(("agents", "active")))
        if self.curiosity is None:
            batch = batch.exclude("next")  # large, and read by the advantage estimator and curiosity only
        self._buffer.empty()
        self._buffer.extend(
            batch.reshape(self.config.optimization.num_envs, -1) if self.config.model.recurrent else batch.reshape(-1)
        )
        warmup = round(done * self.config.num_updates) < self.config.ppo.warmup_updates
        num_epochs = self.config.optimization.num_epochs
        losses = [self._improve(part, warmup) for _ in range(num_epochs) for part in self._buffer]
        means |= {name: torch.stack([part[name] for part in losses]).mean() for name in losses[0]}
        return {name: float(value) for name, value in means.items()}

    def anneal(self, done: float) -> float:
        """Decay the learning rates and the entropy bonus linearly, and return the factor."""
        factor = super().anneal(done)
        entropy_coeff: Tensor = self.loss.get_buffer("entropy_coeff")
        entropy_coeff.fill_(self.config.ppo.entropy_coeff * factor)
        return factor

    def _set_values(self, batch: TensorDictBase) -> None:
        """Set the values of a batch's states and next states.

        The value of a next state is that of the following step, except at the end of an episode and of the batch.
        """
        key = self.loss.tensor_keys.value
        value = torch.cat([self._value(part) for part in batch.reshape(-1).split(self._minibatch_size)])
        value = value.reshape(*batch.shape, *value.shape[1:])
        next_value = value.roll(-1, batch.ndim - 1)
        ends = batch.get(("next", "done")).any(-1)
        ends[..., -1] = True
        next_value[ends] = self._value(batch.get("next")[ends])
        batch.set(key, value)
        batch.set(("next", key), next_value)

    def _value(self, states: TensorDictBase) -> Tensor:
        """Return the critic's values of states."""
        critic = self.loss.critic_network
        with self.loss.critic_network_params.to_module(critic):
            return critic(states.select(*critic.in_keys)).get(self.loss.tensor_keys.value)

    def _penalize(self, batch: TensorDictBase, initial: nn.Module) -> Tensor:
        """Subtract the penalty for deviating from the initial policy from the reward; return an estimate of the KL."""
        with torch.no_grad():
            (logits,) = initial(*(batch.get(key) for key in self._observation_keys))
            before = logits.log_softmax(-1).gather(-1, batch.get(("agents", "action")).unsqueeze(-1))
            divergence = batch.get(("agents", "action_log_prob")).unsqueeze(-1) - before
        reward = batch.get(("next", self._reward_key))
        batch.set(("next", self._reward_key), reward - self.config.ppo.kl_coeff * divergence)
        return divergence.mean()

    def _improve(self, part: TensorDictBase, warmup: bool) -> dict[str, Tensor]:
        """Take one gradient step on a minibatch, in which only the critic learns if `warmup`; return the loss terms."""
        with self.autocast():
            terms = self._terms(part)
        total: Tensor = terms["loss_critic"]
        if not warmup:
            total = total + terms["loss_objective"] + terms["loss_entropy"]
        reported = {name: terms[name].detach() for name in ("loss_objective", "loss_critic", "entropy", "kl_approx")}
        if self.curiosity is not None:
            with self.autocast():
                surprise = self.curiosity.loss(part)
            total, reported["loss_curiosity"] = total + surprise, surprise.detach()
        self.step(total, self.config.optimization.max_grad_norm)
        return reported


def _set_agent_ends(batch: TensorDictBase) -> None:
    """Set the per-agent `done` and `terminated`: an agent's episode ends when the agent disappears.

    In later steps the agent observes zeros and its actions have no effect, so `LOSS_MASK` excludes them. (A single
    action of the whole team with one advantage cannot be masked per agent; there, the rows of agents that have
    disappeared add noise, but no bias.)
    """
    after = batch.get("next")
    gone = ~after.get(("agents", "active"))
    for flag in ("done", "terminated"):
        after.set(("agents", flag), gone | after.get(flag).unsqueeze(-2))


def _make_buffer(config: TrainConfig, device: torch.device) -> TensorDictReplayBuffer:
    """Return the buffer that splits a batch into minibatches: of sequences for recurrent networks, otherwise of steps.

    It stores the batch on `device`, the device of the networks.
    """
    optimization = config.optimization
    row_steps = optimization.steps_per_batch if config.model.recurrent else 1
    return TensorDictReplayBuffer(
        storage=LazyTensorStorage(optimization.num_envs * optimization.steps_per_batch // row_steps, device=device),
        sampler=SamplerWithoutReplacement(),
        batch_size=max(1, optimization.minibatch_size // row_steps),
    )


class PPOAlgorithm(Algorithm):
    """Base class of algorithms with an actor, a critic and a reward."""

    reward_key: NestedKey = ("agents", "reward")
    """Key of the reward that the loss uses."""
    action_key: ClassVar[NestedKey] = ("agents", "action")
    """Key of the discrete action that each agent took."""
    policy: ProbabilisticActor
    """The network and the distribution of actions, as the loss uses them."""

    def __init__(self, config: TrainConfig) -> None:
        """Build the networks and the loss; raises `ValueError` with `decision_rounds`."""
        if config.model.decision_rounds > 1:
            expected = f"1 with {config.algorithm}, whose agents act at the same time"
            raise ValueError(f"decision_rounds={config.model.decision_rounds}: expected {expected}")
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
        return PPOLearner(self)

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
    added_layers = ("log_scale",)
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
