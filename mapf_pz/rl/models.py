"""The networks: plain modules over any leading dimensions, so that a policy acts with any number of agents."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from mapf_pz.rl.config import ModelConfig


class Encoder(nn.Module):
    """One agent's observation, image `(..., K, h, w)` and features `(..., F)`, to `(..., hidden)`."""

    def __init__(self, image_shape: tuple[int, int, int], num_features: int, config: ModelConfig) -> None:
        """Build the convolutions (3 x 3, no padding while the image is larger than that) and one linear layer."""
        super().__init__()
        channels, height, width = image_shape
        layers: list[nn.Module] = []
        for out_channels in config.conv_channels:
            padding = 0 if min(height, width) > 3 else 1
            layers += [_scaled(nn.Conv2d(channels, out_channels, 3, padding=padding), math.sqrt(2)), nn.ReLU()]
            channels, height, width = out_channels, height - 2 + 2 * padding, width - 2 + 2 * padding
        self.image = nn.Sequential(*layers, nn.Flatten())
        size = channels * height * width + num_features
        self.joint = nn.Sequential(_scaled(nn.Linear(size, config.hidden), math.sqrt(2)), nn.ReLU())

    def forward(self, image: Tensor, features: Tensor | None = None) -> Tensor:
        """Encode the observations of all agents at once."""
        lead = image.shape[:-3]
        code = self.image(image.flatten(0, -4)).unflatten(0, lead)
        return self.joint(code if features is None else torch.cat([code, features], -1))


class Actor(nn.Module):
    """Logits `(..., A)` from one agent's own observation."""

    def __init__(
        self, image_shape: tuple[int, int, int], num_features: int, num_actions: int, config: ModelConfig
    ) -> None:
        """Build the encoder and a head of one hidden layer."""
        super().__init__()
        self.encoder = Encoder(image_shape, num_features, config)
        self.head = _head(config.hidden, config.hidden, num_actions, scale=0.01)

    def forward(self, image: Tensor, features: Tensor | None = None) -> Tensor:
        """Return unnormalized log-probabilities."""
        return self.head(self.encoder(image, features))


class LocalCritic(nn.Module):
    """Value `(..., N, 1)` of each agent from its own observation."""

    def __init__(self, image_shape: tuple[int, int, int], num_features: int, config: ModelConfig) -> None:
        """Build the encoder and a head of one hidden layer."""
        super().__init__()
        self.encoder = Encoder(image_shape, num_features, config)
        self.head = _head(config.hidden, config.hidden, 1, scale=1.0)

    def forward(self, image: Tensor, features: Tensor | None = None) -> Tensor:
        """Return the values."""
        return self.head(self.encoder(image, features))


class TeamCritic(nn.Module):
    """Value `(..., N, 1)` of each agent from its own code and the mean code of the whole team.

    The mean over agents (Zaheer et al., *Deep Sets*, 2017) sees all agents at a cost that grows with N, not N x N.
    """

    def __init__(self, image_shape: tuple[int, int, int], num_features: int, config: ModelConfig) -> None:
        """Build the encoder and a head of one hidden layer."""
        super().__init__()
        self.encoder = Encoder(image_shape, num_features, config)
        self.head = _head(2 * config.hidden, config.hidden, 1, scale=1.0)

    def forward(self, image: Tensor, features: Tensor | None = None) -> Tensor:
        """Return the values; the agents are the dimension before the image's three."""
        code = self.encoder(image, features)
        team = code.mean(-2, keepdim=True).expand_as(code)
        return self.head(torch.cat([code, team], -1))


def _head(size: int, hidden: int, out: int, scale: float) -> nn.Sequential:
    return nn.Sequential(
        _scaled(nn.Linear(size, hidden), math.sqrt(2)), nn.ReLU(), _scaled(nn.Linear(hidden, out), scale)
    )


def _scaled(layer: nn.Linear | nn.Conv2d, scale: float) -> nn.Module:
    """Initialize orthogonally with gain `scale`, and without bias: what PPO learns best from (Huang et al., 2022)."""
    nn.init.orthogonal_(layer.weight, scale)
    if layer.bias is not None:
        nn.init.zeros_(layer.bias)
    return layer
