"""Proximal policy optimization on batches of steps, with an optional curiosity reward."""

from __future__ import annotations

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.data.replay_buffers.samplers import SamplerWithoutReplacement
from torchrl.objectives import PPOLoss

from mapf_pz.rl.config import TrainConfig
from mapf_pz.rl.curiosity import make_curiosity
from mapf_pz.rl.learner import Learner

LOSS_MASK = "shifted_valid"
"""TorchRL's key of a mask: entries that are False are excluded from losses and from advantage normalization."""


class PPOLearner(Learner):
    """Proximal policy optimization (Schulman et al., 2017) of a loss, which contains the actor and the critic."""

    def __init__(
        self, config: TrainConfig, loss: PPOLoss, reward_key: NestedKey, action_key: NestedKey, agents_end: bool
    ) -> None:
        """Create the optimizer for the loss's networks, on their device.

        Args:
            config: the configuration of the run.
            loss: the loss; its value estimator bootstraps truncated episodes, but not terminated ones.
            reward_key: key of the reward that the loss uses.
            action_key: key of the discrete action that each agent took.
            agents_end: whether an agent's episode ends when the agent disappears.
        """
        self.config = config
        self.loss = loss
        self.curiosity = make_curiosity(config, action_key)
        self._reward_key = reward_key
        self._agents_end = agents_end
        self._device = next(self.loss.parameters()).device
        self.modules = {"loss": self.loss}
        groups = [{"params": list(self.loss.parameters()), "initial_lr": config.ppo.learning_rate}]
        if self.curiosity is not None:
            self.modules["curiosity"] = self.curiosity.to(self._device)
            trained = [parameter for parameter in self.curiosity.parameters() if parameter.requires_grad]
            groups.append({"params": trained, "initial_lr": config.curiosity.learning_rate})
        self.optimizer = torch.optim.Adam(groups, eps=1e-5)
        self._buffer = _make_buffer(config, self._device)

    def learn(self, batch: TensorDictBase, done: float) -> dict[str, float]:
        """Update the networks with a batch, as in `Learner`."""
        self.anneal(done)
        batch = batch.to(self._device)
        if self._agents_end:
            _set_agent_ends(batch)
        means: dict[str, Tensor] = {}
        if self.curiosity is not None:
            means["intrinsic_reward"] = self.curiosity.add_reward(batch, self._reward_key)
        with torch.no_grad():
            self.loss.value_estimator(
                batch,
                params=self.loss.critic_network_params,
                target_params=self.loss.target_critic_network_params,
            )
        if self._agents_end:
            batch.set(LOSS_MASK, batch.get(("agents", "active")))
        self._buffer.empty()
        self._buffer.extend(
            batch.reshape(self.config.ppo.num_envs, -1) if self.config.model.recurrent else batch.reshape(-1)
        )
        losses = [self._improve(part) for _ in range(self.config.ppo.num_epochs) for part in self._buffer]
        means |= {name: torch.stack([part[name] for part in losses]).mean() for name in losses[0]}
        return {name: float(value) for name, value in means.items()}

    def anneal(self, done: float) -> float:
        """Decay the learning rates and the entropy bonus linearly to a tenth, and return the factor."""
        factor = super().anneal(done)
        entropy_coeff: Tensor = self.loss.get_buffer("entropy_coeff")
        entropy_coeff.fill_(self.config.ppo.entropy_coeff * factor)
        return factor

    def _improve(self, part: TensorDictBase) -> dict[str, Tensor]:
        """Take one gradient step on a minibatch, and return the loss terms by name."""
        terms = self.loss(part)
        total: Tensor = terms["loss_objective"] + terms["loss_critic"] + terms["loss_entropy"]
        reported = {name: terms[name].detach() for name in ("loss_objective", "loss_critic", "entropy", "kl_approx")}
        if self.curiosity is not None:
            surprise = self.curiosity.loss(part)
            total, reported["loss_curiosity"] = total + surprise, surprise.detach()
        self.step(total, self.config.ppo.max_grad_norm)
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
    row_steps = config.ppo.steps_per_batch if config.model.recurrent else 1
    return TensorDictReplayBuffer(
        storage=LazyTensorStorage(config.ppo.num_envs * config.ppo.steps_per_batch // row_steps, device=device),
        sampler=SamplerWithoutReplacement(),
        batch_size=max(1, config.ppo.minibatch_size // row_steps),
    )
