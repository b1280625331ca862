"""The networks: plain modules over any leading dimensions."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from mapf_pz.rl.config import Credit, ModelConfig
from mapf_pz.rl.observed import Observed


class Encoder(nn.Module):
    """One observation, image `(..., K, h, w)` and features `(..., F)`, to a code `(..., hidden)`."""

    def __init__(self, observed: Observed, config: ModelConfig) -> None:
        """Build the convolutions (3 x 3, no padding while the image is larger than that) and one linear layer."""
        super().__init__()
        channels, height, width = observed.image
        layers: list[nn.Module] = []
        for out_channels in config.conv_channels:
            padding = 0 if min(height, width) > 3 else 1
            layers += [_scaled(nn.Conv2d(channels, out_channels, 3, padding=padding)), nn.ReLU()]
            channels, height, width = out_channels, height - 2 + 2 * padding, width - 2 + 2 * padding
        self.image = nn.Sequential(*layers, nn.Flatten())
        size = channels * height * width + observed.features
        self.joint = nn.Sequential(_scaled(nn.Linear(size, config.hidden)), nn.ReLU())

    def forward(self, image: Tensor, features: Tensor | None = None) -> Tensor:
        """Encode all observations at once."""
        lead = image.shape[:-3]
        code = self.image(image.reshape(-1, *image.shape[-3:])).reshape(*lead, -1)
        return self.joint(code if features is None else torch.cat([code, features], -1))


class Actor(nn.Module):
    """Logits `(..., A)` from one agent's own observation; works with any number of agents."""

    def __init__(self, observed: Observed, config: ModelConfig) -> None:
        """Build the encoder and the head."""
        super().__init__()
        self.encoder = Encoder(observed, config)
        self.head = _head(config.hidden, config.head, observed.actions, scale=0.01)

    def forward(self, image: Tensor, features: Tensor | None = None) -> Tensor:
        """Return unnormalized log-probabilities."""
        return self.head(self.encoder(image, features))


class LocalCritic(nn.Module):
    """Value `(..., N, 1)` of each agent from its own observation."""

    def __init__(self, observed: Observed, config: ModelConfig) -> None:
        """Build the encoder and the head."""
        super().__init__()
        self.encoder = Encoder(observed, config)
        self.head = _head(config.hidden, config.head, 1, scale=1.0)

    def forward(self, image: Tensor, features: Tensor | None = None) -> Tensor:
        """Return the values."""
        return self.head(self.encoder(image, features))


class TeamCritic(nn.Module):
    """Value `(..., N, 1)` of each agent from its own code and the mean code of the whole team.

    The mean over agents (Zaheer et al., *Deep Sets*, 2017) sees all agents at a cost that grows with N, not N x N.
    """

    def __init__(self, observed: Observed, config: ModelConfig) -> None:
        """Build the encoder and the head."""
        super().__init__()
        self.encoder = Encoder(observed, config)
        self.head = _head(2 * config.hidden, config.head, 1, scale=1.0)

    def forward(self, image: Tensor, features: Tensor | None = None) -> Tensor:
        """Return the values; the agents are the dimension before the image's three."""
        code = self.encoder(image, features)
        team = code.mean(-2, keepdim=True).expand_as(code)
        return self.head(torch.cat([code, team], -1))


class TeamActor(nn.Module):
    """The report's policy: mean and spread `(..., N, A)` of the action matrix from all stacked observations."""

    def __init__(self, observed: Observed, num_agents: int, config: ModelConfig) -> None:
        """Build the encoder of N * K planes, the head, and one spread per number that no observation changes."""
        super().__init__()
        self.encoder = Encoder(observed.stacked(num_agents), config)
        self.head = _head(config.hidden, config.head, num_agents * observed.actions, scale=0.01)
        self.log_scale = nn.Parameter(torch.full((num_agents, observed.actions), -0.5))

    def forward(self, image: Tensor, features: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Return the mean and the standard deviation."""
        mean = self.head(self.encoder(image, features)).unflatten(-1, self.log_scale.shape)
        return mean, self.log_scale.exp().expand_as(mean)


class TeamValue(nn.Module):
    """Values from all agents' stacked observations: `(..., 1)` of the team, or `(..., N, 1)` of each agent."""

    def __init__(self, observed: Observed, num_agents: int, credit: Credit, config: ModelConfig) -> None:
        """Build the encoder and the head."""
        super().__init__()
        self.encoder = Encoder(observed.stacked(num_agents), config)
        self.shape = (1,) if credit == "team" else (num_agents, 1)
        self.head = _head(config.hidden, config.head, math.prod(self.shape), scale=1.0)

    def forward(self, image: Tensor, features: Tensor | None = None) -> Tensor:
        """Return the values."""
        return self.head(self.encoder(image, features)).unflatten(-1, self.shape)


def _head(size: int, hidden: tuple[int, ...], out: int, scale: float) -> nn.Sequential:
    layers: list[nn.Module] = []
    for width in hidden:
        layers += [_scaled(nn.Linear(size, width)), nn.ReLU()]
        size = width
    return nn.Sequential(*layers, _scaled(nn.Linear(size, out), scale))


def _scaled(layer: nn.Linear | nn.Conv2d, scale: float = math.sqrt(2)) -> nn.Module:
    """Initialize orthogonally with gain `scale`, and without bias: what PPO learns best from (Huang et al., 2022)."""
    nn.init.orthogonal_(layer.weight, scale)
    if layer.bias is not None:
        nn.init.zeros_(layer.bias)
    return layer
