"""Curiosity: a reward for what an agent could not predict, beside the task's own.

TorchRL's `RNDTransform` gives such a reward while environments are stepped. Here it is given to a whole batch
afterwards: collectors' workers then need no predictor, and the statistics are those of all environments.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from itertools import pairwise

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor, nn
from torch.nn.functional import cross_entropy, one_hot
from torchrl.envs.transforms.rnd import RunningMeanStd
from torchrl.objectives import RNDLoss

from mapf_pz.rl.config import CuriosityConfig, CuriosityName, ModelConfig, TrainConfig
from mapf_pz.rl.encoders import make_encoder, scaled
from mapf_pz.rl.observed import Observed

_SEEN: NestedKey = ("agents", "observation")
_NEXT_SEEN: NestedKey = ("next", "agents", "observation")


class Embedding(nn.Module):
    """Numbers `(..., size)` for one agent's observation, as the batch has it: an image, or an image and features.

    The observation is not whitened as by Burda et al.: its entries are of one scale already.
    """

    def __init__(self, observed: Observed, model: ModelConfig, size: int, num_hidden: int = 0) -> None:
        """Build the policy's kind of encoder, `num_hidden` layers on its code, and a linear one."""
        super().__init__()
        self.encoder = make_encoder(observed, model)
        self.head = _layers([model.hidden] * (num_hidden + 1) + [size])

    def forward(self, seen: Tensor | TensorDictBase) -> Tensor:
        """Embed all observations at once."""
        parts = (seen,) if isinstance(seen, Tensor) else (seen["image"], seen["features"])
        return self.head(self.encoder(*parts))


class RewardScale(nn.Module):
    """Divides rewards by the standard deviation of their discounted sums (Burda et al., 2018, section 2.4).

    Each environment and agent has a sum, `R <- gamma * R + r`. It goes on over the ends of episodes and of batches;
    the deviation is that of all sums so far. The mean is not subtracted: rewards stay positive.
    """

    def __init__(self, num_envs: int, num_agents: int, gamma: float) -> None:
        """Begin with sums of zero."""
        super().__init__()
        self.gamma = gamma
        self.statistics = RunningMeanStd()
        self.register_buffer("sums", torch.zeros(num_envs, num_agents))

    def forward(self, rewards: Tensor) -> Tensor:
        """Count the rewards `(B, T, N)` in and return them scaled."""
        total: Tensor = self.get_buffer("sums")
        sums: list[Tensor] = []
        for reward in rewards.unbind(1):
            total = self.gamma * total + reward
            sums.append(total)
        self.get_buffer("sums").copy_(total)
        self.statistics.update(torch.stack(sums))
        return rewards / (self.statistics.get_buffer("var").sqrt() + 1e-8)


class Curiosity(nn.Module, ABC):
    """What the training loop needs to know; its networks are shared by all agents, and learn beside the policy's.

    The reward is one of the episode: unlike the papers', its return ends where the episode does, because one critic
    values it together with the task's.
    """

    def __init__(self, config: TrainConfig, action_key: NestedKey) -> None:
        """Start without statistics; `action_key` is the key of the action that each agent took."""
        super().__init__()
        self.action_key = action_key
        self.config: CuriosityConfig = config.curiosity
        self.scale = RewardScale(config.ppo.num_envs, config.task.num_agents, config.curiosity.gamma)

    @abstractmethod
    def surprise(self, steps: TensorDictBase) -> Tensor:
        """Return the error `(..., N)` of what was predicted of each agent's step."""

    def learn(self, steps: TensorDictBase) -> Tensor:
        """Return the loss of these steps: by default, the mean surprise."""
        return self.surprise(steps).mean()

    @torch.no_grad()
    def reward(self, batch: TensorDictBase) -> Tensor:
        """Return the scaled surprise `(..., T, N, 1)` of a batch of steps `(..., T)`; counts it in, so ask once."""
        surprise = self.surprise(batch)
        return self.scale(surprise.reshape(-1, *surprise.shape[-2:])).view_as(surprise).unsqueeze(-1)

    def add_reward(self, batch: TensorDictBase, key: NestedKey) -> Tensor:
        """Add the weighted reward to that at `("next", key)`, each agent's or the team's; return its mean before."""
        intrinsic, after = self.reward(batch), batch.get("next")
        own = after.get(key)
        each = intrinsic if own.ndim == intrinsic.ndim else intrinsic.mean(-2)
        after.set(key, own + self.config.weight * each)
        return intrinsic.mean()

    def loss(self, minibatch: TensorDictBase) -> Tensor:
        """Return the loss of a random share of the minibatch's steps.

        With many environments, a predictor that learns from each of their steps is done before the policy has learnt
        anything (Burda et al., 2018, section 3.6).
        """
        steps = minibatch.reshape(-1)
        number = math.ceil(self.config.update_fraction * len(steps))
        return self.learn(steps[torch.randperm(len(steps))[:number]])


class RandomNetworkDistillation(Curiosity):
    """`r = mean_j (f_j(s') - g_j(s'))^2`: f learns what a fixed random network g makes of the next observation.

    Burda et al., *Exploration by Random Network Distillation*, 2018; f has two more layers than g, as there.
    """

    def __init__(self, config: TrainConfig, action_key: NestedKey) -> None:
        """Build f and g."""
        super().__init__(config, action_key)
        observed, size = Observed.by_policy_of(config.task), self.config.size
        predictor = Embedding(observed, config.model, size, num_hidden=2)
        target = Embedding(observed, config.model, size)
        self.distillation = RNDLoss(predictor, target, reduction="none", update_fraction=1.0)
        self.distillation.set_keys(observation=_NEXT_SEEN)

    def surprise(self, steps: TensorDictBase) -> Tensor:
        """Return the error of f; actions do not matter."""
        return self.distillation(steps)["loss_predictor"]


class ForwardDynamics(Curiosity):
    """`r = mean_j (f_j(phi(s), a) - phi_j(s'))^2`, with a fixed random embedding phi.

    Burda et al., *Large-Scale Study of Curiosity-Driven Learning*, 2018. Their f is a residual network that is told the
    action in every layer; this one is smaller, and is told once.
    """

    def __init__(self, config: TrainConfig, action_key: NestedKey) -> None:
        """Build phi and f."""
        super().__init__(config, action_key)
        observed, size, hidden = Observed.by_policy_of(config.task), self.config.size, config.model.hidden
        self.num_actions = observed.actions
        self.embedding = Embedding(observed, config.model, size).requires_grad_(False)
        self.forward_model = _layers([size + observed.actions, hidden, hidden, size])

    def surprise(self, steps: TensorDictBase) -> Tensor:
        """Return the error of f."""
        return self._error(steps, *self._embedded(steps))

    def _embedded(self, steps: TensorDictBase) -> tuple[Tensor, Tensor]:
        # `next` has an episode's true last observation, also where another episode began after the step.
        return self.embedding(steps.get(_SEEN)), self.embedding(steps.get(_NEXT_SEEN))

    def _error(self, steps: TensorDictBase, before: Tensor, after: Tensor) -> Tensor:
        action = one_hot(steps.get(self.action_key), self.num_actions).to(before.dtype)
        return (self.forward_model(torch.cat([before, action], -1)) - after).square().mean(-1)


class InverseDynamics(ForwardDynamics):
    """The same with a learned phi: it learns only to tell, from phi(s) and phi(s'), which action was taken.

    What actions neither change nor depend on need not be in such a phi (Pathak et al., *Curiosity-driven Exploration by
    Self-supervised Prediction*, 2017), so it does not surprise.
    """

    def __init__(self, config: TrainConfig, action_key: NestedKey) -> None:
        """Build phi, f and what names the action."""
        super().__init__(config, action_key)
        self.embedding.requires_grad_(True)
        self.inverse_model = _layers([2 * self.config.size, config.model.hidden, self.num_actions])

    def learn(self, steps: TensorDictBase) -> Tensor:
        """Return the mean error of f, from which phi does not learn, and the cross-entropy of the actions."""
        before, after = self._embedded(steps)
        logits = self.inverse_model(torch.cat([before, after], -1))
        inverse = cross_entropy(logits.flatten(0, -2), steps.get(self.action_key).flatten())
        return self._error(steps, before.detach(), after.detach()).mean() + inverse


CURIOSITIES: dict[CuriosityName, type[Curiosity] | None] = {
    "none": None,
    "rnd": RandomNetworkDistillation,
    "random-features": ForwardDynamics,
    "inverse-dynamics": InverseDynamics,
}
"""The kinds of curiosity by name."""


def make_curiosity(config: TrainConfig, action_key: NestedKey) -> Curiosity | None:
    """Return the configuration's kind of curiosity with fresh weights; None for `none`."""
    kind = CURIOSITIES[config.curiosity.kind]
    return None if kind is None else kind(config, action_key)


def _layers(sizes: list[int]) -> nn.Sequential:
    """Return linear layers of these sizes with ReLU between them."""
    layers: list[nn.Module] = []
    for size, after in pairwise(sizes):
        layers += [scaled(nn.Linear(size, after)), nn.ReLU()]
    return nn.Sequential(*layers[:-1])
