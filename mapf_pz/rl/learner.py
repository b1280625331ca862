"""The learner: updates an algorithm's networks and its curiosity from batches of steps."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.data.replay_buffers.samplers import SamplerWithoutReplacement

from mapf_pz.rl.algorithms import Algorithm
from mapf_pz.rl.config import TrainConfig
from mapf_pz.rl.curiosity import make_curiosity

LOSS_MASK = "shifted_valid"
"""TorchRL's key of a mask: entries that are False are excluded from losses and from advantage normalization."""


class Learner:
    """Proximal policy optimization on batches; its state includes that of torch's random number generator."""

    def __init__(self, algorithm: Algorithm, config: TrainConfig) -> None:
        """Create the optimizer for the algorithm's networks, on their device."""
        self.config = config
        self.loss = algorithm.loss
        self.curiosity = make_curiosity(config, algorithm.action_key)
        self._reward_key = algorithm.reward_key
        self._agents_end = algorithm.agents_end
        self._device = next(self.loss.parameters()).device
        self.modules: dict[str, nn.Module] = {"loss": self.loss}
        groups = [{"params": list(self.loss.parameters()), "initial_lr": config.ppo.learning_rate}]
        if self.curiosity is not None:
            self.modules["curiosity"] = self.curiosity.to(self._device)
            trained = [parameter for parameter in self.curiosity.parameters() if parameter.requires_grad]
            groups.append({"params": trained, "initial_lr": config.curiosity.learning_rate})
        self.optimizer = torch.optim.Adam(groups, eps=1e-5)
        self._buffer = _make_buffer(config, self._device)

    def learn(self, batch: TensorDictBase, done: float) -> dict[str, float]:
        """Update the networks with a batch of B x T steps, and return the means of the loss terms by name.

        Args:
            batch: the batch from the collector.
            done: the completed fraction of the run, in [0, 1].
        """
        self._anneal(done)
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

    def tensors(self) -> dict[str, Tensor]:
        """Return copies of the state that training changes, except learning rates, which `learn` sets."""
        tensors: dict[str, Tensor] = {}
        for part, module in self.modules.items():
            tensors |= {f"{part}/{name}": tensor for name, tensor in module.state_dict().items()}
        for index, entries in self.optimizer.state_dict()["state"].items():
            tensors |= {f"optimizer/{index}/{name}": tensor for name, tensor in entries.items()}
        tensors["random"] = torch.get_rng_state()
        return {name: tensor.detach().cpu().clone().contiguous() for name, tensor in tensors.items()}

    def restore(self, tensors: Mapping[str, Tensor]) -> None:
        """Restore the state that `tensors` returned.

        Raises `RuntimeError`, `LookupError` or `ValueError` if it belongs to other networks.
        """
        modules: dict[str, dict[str, Tensor]] = {part: {} for part in self.modules}
        optimizer: dict[int, dict[str, Tensor]] = {}
        for name, tensor in tensors.items():
            part, _, rest = name.partition("/")
            if part == "optimizer":
                index, _, entry = rest.partition("/")
                optimizer.setdefault(int(index), {})[entry] = tensor.clone()
            elif part != "random":
                modules[part][rest] = tensor.clone()
        for part, module in self.modules.items():
            module.load_state_dict(modules[part])
        groups = self.optimizer.state_dict()["param_groups"]
        self.optimizer.load_state_dict({"state": optimizer, "param_groups": groups})
        torch.set_rng_state(tensors["random"].clone())

    def _anneal(self, done: float) -> None:
        """Decay the learning rates and the entropy bonus linearly to a tenth."""
        factor = 1 - 0.9 * done
        for group in self.optimizer.param_groups:
            group["lr"] = group["initial_lr"] * factor
        entropy_coeff: Tensor = self.loss.get_buffer("entropy_coeff")
        entropy_coeff.fill_(self.config.ppo.entropy_coeff * factor)

    def _improve(self, part: TensorDictBase) -> dict[str, Tensor]:
        """Take one gradient step on a minibatch, and return the loss terms by name."""
        terms = self.loss(part)
        total: Tensor = terms["loss_objective"] + terms["loss_critic"] + terms["loss_entropy"]
        reported = {name: terms[name].detach() for name in ("loss_objective", "loss_critic", "entropy", "kl_approx")}
        if self.curiosity is not None:
            surprise = self.curiosity.loss(part)
            total, reported["loss_curiosity"] = total + surprise, surprise.detach()
        self.optimizer.zero_grad()
        total.backward()
        for module in self.modules.values():
            nn.utils.clip_grad_norm_(module.parameters(), self.config.ppo.max_grad_norm)
        self.optimizer.step()
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
