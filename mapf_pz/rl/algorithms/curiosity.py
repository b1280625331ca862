"""Curiosity: an intrinsic reward for what cannot be predicted yet, added to the task's reward.

TorchRL's `RNDTransform` computes such a reward while environments are stepped. Here it is computed for a whole batch
after collection: workers then need no predictor, and the statistics cover all environments.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from itertools import pairwise
from typing import ClassVar

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor, nn
from torch.nn.functional import cross_entropy, one_hot
from torchrl.envs.transforms.rnd import RunningMeanStd
from torchrl.objectives import RNDLoss

from mapf_pz.rl.config import CuriosityConfig, CuriosityName, ModelConfig, TrainConfig
from mapf_pz.rl.networks.encoders import make_encoder, scaled
from mapf_pz.rl.networks.observation_shape import ObservationShape

_OBSERVATION: NestedKey = ("agents", "observation")
_NEXT_OBSERVATION: NestedKey = ("next", "agents", "observation")


class Embedding(nn.Module):
    """Embeddings `(..., size)` of single agents' observations, each an image, or an image and features.

    Unlike in Burda et al., observations are not whitened: their entries already have the same scale.
    """

    def __init__(self, shape: ObservationShape, model: ModelConfig, size: int, num_hidden: int = 0) -> None:
        """Build an encoder like the policy's, `num_hidden` hidden layers, and a linear output layer."""
        super().__init__()
        self.encoder = make_encoder(shape, model)
        self.head = _layers([model.hidden] * (num_hidden + 1) + [size])

    def forward(self, observation: Tensor | TensorDictBase) -> Tensor:
        """Embed a batch of observations."""
        parts = (observation,) if isinstance(observation, Tensor) else (observation["image"], observation["features"])
        return self.head(self.encoder(*parts))


class RewardScale(nn.Module):
    """Divides rewards by the standard deviation of their discounted sums (Burda et al., 2018, section 2.4).

    Each agent of each environment has a sum, `R <- gamma * R + r`, that continues across the ends of episodes and
    batches. The standard deviation is that of all sums so far. The mean is not subtracted, so rewards stay positive.
    """

    def __init__(self, num_envs: int, num_agents: int, gamma: float) -> None:
        """Initialize all sums to zero."""
        super().__init__()
        self.gamma = gamma
        self.statistics = RunningMeanStd()
        self.register_buffer("sums", torch.zeros(num_envs, num_agents), persistent=False)  # those of the environments

    def forward(self, rewards: Tensor) -> Tensor:
        """Update the statistics with the rewards `(B, T, N)`, and return the scaled rewards."""
        total: Tensor = self.get_buffer("sums")
        sums: list[Tensor] = []
        for reward in rewards.unbind(1):
            total = self.gamma * total + reward
            sums.append(total)
        self.get_buffer("sums").copy_(total)
        self.statistics.update(torch.stack(sums))
        return rewards / (self.statistics.get_buffer("var").sqrt() + 1e-8)


class Curiosity(nn.Module, ABC):
    """Base class of curiosity; its networks are shared by all agents, and trained together with the policy's.

    The reward is episodic. Unlike in the papers, its return ends with the episode, because a single critic estimates
    the value of both rewards together.
    """

    def __init__(self, config: TrainConfig, action_key: NestedKey) -> None:
        """Start with empty statistics; `action_key` is the key of each agent's discrete action."""
        super().__init__()
        self.action_key = action_key
        self.config: CuriosityConfig = config.curiosity
        self.scale = RewardScale(config.optimization.num_envs, config.task.num_agents, config.curiosity.gamma)

    @abstractmethod
    def surprise(self, steps: TensorDictBase) -> Tensor:
        """Return the prediction error `(..., N)` of each agent's step."""

    def learn(self, steps: TensorDictBase) -> Tensor:
        """Return the training loss of these steps: by default, the mean surprise."""
        return self.surprise(steps).mean()

    @torch.no_grad()
    def reward(self, batch: TensorDictBase) -> Tensor:
        """Return the scaled surprise `(..., T, N, 1)` of steps `(..., T)`; updates the statistics, so call it once."""
        surprise = self.surprise(batch)
        return self.scale(surprise.reshape(-1, *surprise.shape[-2:])).view_as(surprise).unsqueeze(-1)

    def add_reward(self, batch: TensorDictBase, key: NestedKey) -> Tensor:
        """Add the weighted reward to the agents' or team's reward at `("next", key)`; return the unweighted mean."""
        intrinsic, after = self.reward(batch), batch.get("next")
        extrinsic = after.get(key)
        bonus = intrinsic if extrinsic.ndim == intrinsic.ndim else intrinsic.mean(-2)
        after.set(key, extrinsic + self.config.weight * bonus)
        return intrinsic.mean()

    def loss(self, minibatch: TensorDictBase) -> Tensor:
        """Return the loss of a random fraction of the minibatch's steps.

        With many environments, a predictor that is trained on every step converges before the policy has learned
        anything (Burda et al., 2018, section 3.6).
        """
        steps = minibatch.reshape(-1)
        number = math.ceil(self.config.update_fraction * len(steps))
        return self.learn(steps[torch.randperm(len(steps))[:number]])


class RandomNetworkDistillation(Curiosity):
    """`r = mean_j (f_j(s') - g_j(s'))^2`: f learns to predict the output of a fixed random network g.

    Burda et al., *Exploration by Random Network Distillation*, 2018. As in the paper, f has two more layers than g.
    """

    def __init__(self, config: TrainConfig, action_key: NestedKey) -> None:
        """Build f and g."""
        super().__init__(config, action_key)
        shape, size = ObservationShape.of_task(config.task), self.config.size
        predictor = Embedding(shape, config.model, size, num_hidden=2)
        target = Embedding(shape, config.model, size)
        self.distillation = RNDLoss(predictor, target, reduction="none", update_fraction=1.0)
        self.distillation.set_keys(observation=_NEXT_OBSERVATION)

    def surprise(self, steps: TensorDictBase) -> Tensor:
        """Return the error of f, which does not depend on the actions."""
        return self.distillation(steps)["loss_predictor"]


class ForwardDynamics(Curiosity):
    """`r = mean_j (f_j(phi(s), a) - phi_j(s'))^2`, with a fixed random embedding phi.

    Burda et al., *Large-Scale Study of Curiosity-Driven Learning*, 2018. Their f is a residual network that
    receives the action in every layer; this one is smaller, and receives it once.
    """

    num_models: ClassVar[int] = 1
    """Number K of networks f, which differ in their initial weights."""

    def __init__(self, config: TrainConfig, action_key: NestedKey) -> None:
        """Build phi and f."""
        super().__init__(config, action_key)
        shape, size, hidden = ObservationShape.of_task(config.task), self.config.size, config.model.hidden
        self.num_actions = shape.actions
        self.embedding = Embedding(shape, config.model, size).requires_grad_(False)
        sizes = [size + shape.actions, hidden, hidden, size]
        self.forward_models = nn.ModuleList(_layers(sizes) for _ in range(self.num_models))

    def surprise(self, steps: TensorDictBase) -> Tensor:
        """Return the error of f."""
        return self._error(steps, *self._embedded(steps))

    def _embedded(self, steps: TensorDictBase) -> tuple[Tensor, Tensor]:
        # `next` holds an episode's true final observation, even if the environment was reset after the step.
        return self.embedding(steps.get(_OBSERVATION)), self.embedding(steps.get(_NEXT_OBSERVATION))

    def _predictions(self, steps: TensorDictBase, before: Tensor) -> Tensor:
        """Return the embeddings (K, ..., N, size) that the networks predict."""
        action = one_hot(steps.get(self.action_key), self.num_actions).to(before.dtype)
        inputs = torch.cat([before, action], -1)
        return torch.stack([model(inputs) for model in self.forward_models])

    def _error(self, steps: TensorDictBase, before: Tensor, after: Tensor) -> Tensor:
        return (self._predictions(steps, before) - after).square().mean((0, -1))


class InverseDynamics(ForwardDynamics):
    """Forward dynamics with a learned phi, trained only to predict the action from phi(s) and phi(s').

    Such a phi need not represent anything that is independent of the actions, so that this yields no surprise (Pathak
    et al., *Curiosity-driven Exploration by Self-supervised Prediction*, 2017).
    """

    def __init__(self, config: TrainConfig, action_key: NestedKey) -> None:
        """Build phi, f and the network that predicts the action."""
        super().__init__(config, action_key)
        self.embedding.requires_grad_(True)
        self.inverse_model = _layers([2 * self.config.size, config.model.hidden, self.num_actions])

    def learn(self, steps: TensorDictBase) -> Tensor:
        """Return the mean error of f, whose gradient does not reach phi, plus the cross-entropy of the actions."""
        before, after = self._embedded(steps)
        logits = self.inverse_model(torch.cat([before, after], -1))
        inverse = cross_entropy(logits.flatten(0, -2), steps.get(self.action_key).flatten())
        return self._error(steps, before.detach(), after.detach()).mean() + inverse


class Disagreement(ForwardDynamics):
    """`r = mean_j var_k f_kj(phi(s), a)`: how much K networks, which all learn to predict phi(s'), differ.

    Sekar et al., *Planning to Explore via Self-Supervised World Models* (Plan2Explore), 2020, where phi is the encoder
    of a world model, and a planner maximizes r; here phi is a fixed random embedding, and r is a reward, as in Pathak
    et al., *Self-Supervised Exploration via Disagreement*, 2019. Unlike an error, r also falls where outcomes are
    random.
    """

    num_models = 5

    def surprise(self, steps: TensorDictBase) -> Tensor:
        """Return the variance of the predictions, which does not depend on the outcomes."""
        return self._predictions(steps, self.embedding(steps.get(_OBSERVATION))).var(0).mean(-1)

    def learn(self, steps: TensorDictBase) -> Tensor:
        """Return the mean error of the networks."""
        return self._error(steps, *self._embedded(steps)).mean()


CURIOSITIES: dict[CuriosityName, type[Curiosity] | None] = {
    "none": None,
    "rnd": RandomNetworkDistillation,
    "random-features": ForwardDynamics,
    "inverse-dynamics": InverseDynamics,
    "disagreement": Disagreement,
}
"""The kinds of curiosity, by name."""


def make_curiosity(config: TrainConfig, action_key: NestedKey) -> Curiosity | None:
    """Return the configured kind of curiosity, newly initialized; None for `none`."""
    kind = CURIOSITIES[config.curiosity.kind]
    return None if kind is None else kind(config, action_key)


def _layers(sizes: list[int]) -> nn.Sequential:
    """Return linear layers of these sizes with ReLU between them."""
    layers: list[nn.Module] = []
    for size, after in pairwise(sizes):
        layers += [scaled(nn.Linear(size, after)), nn.ReLU()]
    return nn.Sequential(*layers[:-1])
