"""Proximal policy optimization on batches of steps, with an optional curiosity reward."""

from __future__ import annotations

from typing import NamedTuple, cast

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor, nn
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.data.replay_buffers.samplers import SamplerWithoutReplacement
from torchrl.objectives import PPOLoss
from torchrl.objectives.value import GAE

from mapf_pz.rl.algorithms.curiosity import make_curiosity
from mapf_pz.rl.algorithms.learner import Learner
from mapf_pz.rl.config import TrainConfig
from mapf_pz.rl.environments.transfer import to_device

LOSS_MASK = "shifted_valid"
"""TorchRL's key of a mask: entries that are False are excluded from losses and from advantage normalization."""


class PPOKeys(NamedTuple):
    """Keys of the batch."""

    reward: NestedKey
    """The reward that the loss uses."""
    action: NestedKey
    """The discrete action that each agent took."""
    observation: list[NestedKey]
    """The inputs of the policy's network."""


class PPOLearner(Learner):
    """Proximal policy optimization (Schulman et al., 2017) of a loss, which contains the actor and the critic."""

    def __init__(
        self, config: TrainConfig, loss: PPOLoss, keys: PPOKeys, agents_end: bool, initial: nn.Module | None = None
    ) -> None:
        """Create the optimizer for the loss's networks, on their device.

        Args:
            config: the configuration of the run.
            loss: the loss; its value estimator, a `GAE`, bootstraps truncated episodes, but not terminated ones. The
                estimator loses its value network, since the learner computes the values.
            keys: keys of the batch.
            agents_end: whether an agent's episode ends when the agent disappears.
            initial: the policy's network at the start of the run, for the penalty with `kl_coeff`.
        """
        self.config = config
        self.loss = loss
        cast("GAE", loss.value_estimator).value_network = None  # it reads the values of `_set_values`
        self.curiosity = make_curiosity(config, keys.action)
        self._keys = keys
        self._initial = initial
        self._agents_end = agents_end
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
            means["intrinsic_reward"] = self.curiosity.add_reward(batch, self._keys.reward)
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
        """Decay the learning rates and the entropy bonus linearly to a tenth, and return the factor."""
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
            (logits,) = initial(*(batch.get(key) for key in self._keys.observation))
            before = logits.log_softmax(-1).gather(-1, batch.get(("agents", "action")).unsqueeze(-1))
            divergence = batch.get(("agents", "action_log_prob")).unsqueeze(-1) - before
        reward = batch.get(("next", self._keys.reward))
        batch.set(("next", self._keys.reward), reward - self.config.ppo.kl_coeff * divergence)
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
