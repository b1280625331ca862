"""What learns from a batch of steps: the networks of an algorithm, its curiosity, and their optimizer."""

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
"""TorchRL's key: what it marks as False counts neither in a loss nor in the normalization of advantages."""


class Learner:
    """Proximal policy optimization on whole batches; torch's random numbers belong to its state."""

    def __init__(self, algorithm: Algorithm, config: TrainConfig) -> None:
        """Begin with the networks as they are, on the device where they are."""
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
        """Improve the networks on a batch of B x T steps; return what the losses report, their means.

        Args:
            batch: as the collector gives it.
            done: the share of the run that is done, in [0, 1].
        """
        self._anneal(done)
        batch = batch.to(self._device)
        if self._agents_end:
            _note_ends(batch)
        told = (
            {} if self.curiosity is None else {"intrinsic_reward": self.curiosity.add_reward(batch, self._reward_key)}
        )
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
        told |= {name: torch.stack([part[name] for part in losses]).mean() for name in losses[0]}
        return {name: float(value) for name, value in told.items()}

    def tensors(self) -> dict[str, Tensor]:
        """Return copies of all that changes in training; step sizes are not in it, `learn` sets them."""
        tensors: dict[str, Tensor] = {}
        for part, module in self.modules.items():
            tensors |= {f"{part}/{name}": tensor for name, tensor in module.state_dict().items()}
        for index, entries in self.optimizer.state_dict()["state"].items():
            tensors |= {f"optimizer/{index}/{name}": tensor for name, tensor in entries.items()}
        tensors["random"] = torch.get_rng_state()
        return {name: tensor.detach().cpu().clone().contiguous() for name, tensor in tensors.items()}

    def restore(self, tensors: Mapping[str, Tensor]) -> None:
        """Take back what `tensors` returned.

        Raises `RuntimeError`, `LookupError` or `ValueError` where it is not of these networks.
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
        """Lower the step sizes and the entropy bonus linearly to a tenth."""
        share = 1 - 0.9 * done
        for group in self.optimizer.param_groups:
            group["lr"] = group["initial_lr"] * share
        entropy_coeff: Tensor = self.loss.get_buffer("entropy_coeff")
        entropy_coeff.fill_(self.config.ppo.entropy_coeff * share)

    def _improve(self, part: TensorDictBase) -> dict[str, Tensor]:
        """Take one gradient step on a minibatch; return what the losses report."""
        terms = self.loss(part)
        total: Tensor = terms["loss_objective"] + terms["loss_critic"] + terms["loss_entropy"]
        told = {name: terms[name].detach() for name in ("loss_objective", "loss_critic", "entropy", "kl_approx")}
        if self.curiosity is not None:
            surprise = self.curiosity.loss(part)
            total, told["loss_curiosity"] = total + surprise, surprise.detach()
        self.optimizer.zero_grad()
        total.backward()
        for module in self.modules.values():
            nn.utils.clip_grad_norm_(module.parameters(), self.config.ppo.max_grad_norm)
        self.optimizer.step()
        return told


def _note_ends(batch: TensorDictBase) -> None:
    """Set each agent's own `done` and `terminated`: the episode of an agent that disappears ends there.

    Its later steps observe zeros and have no effect, so `LOSS_MASK` excludes them. (One action and one advantage of the
    whole team cannot be masked by agent; there, the action's rows of such agents are noise without a bias.)
    """
    after = batch.get("next")
    gone = ~after.get(("agents", "active"))
    for flag in ("done", "terminated"):
        after.set(("agents", flag), gone | after.get(flag).unsqueeze(-2))


def _make_buffer(config: TrainConfig, device: torch.device) -> TensorDictReplayBuffer:
    """Return the buffer that splits a batch into minibatches, of sequences for recurrent networks, else of steps.

    It stores the batch on `device`, where the networks are.
    """
    row_steps = config.ppo.steps_per_batch if config.model.recurrent else 1
    return TensorDictReplayBuffer(
        storage=LazyTensorStorage(config.ppo.num_envs * config.ppo.steps_per_batch // row_steps, device=device),
        sampler=SamplerWithoutReplacement(),
        batch_size=max(1, config.ppo.minibatch_size // row_steps),
    )
