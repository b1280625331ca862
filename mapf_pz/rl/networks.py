"""The networks: plain modules over any leading dimensions."""

from __future__ import annotations

import math

import torch
from tensordict import TensorDict
from torch import Tensor, nn
from torchrl.modules import GRUModule

from mapf_pz.rl.config import Credit, ModelConfig
from mapf_pz.rl.encoders import make_encoder, scaled
from mapf_pz.rl.observed import Observed


class Actor(nn.Module):
    """Logits `(..., A)` from one agent's own observation; works with any number of agents."""

    def __init__(self, observed: Observed, config: ModelConfig) -> None:
        """Build the encoder and the head."""
        super().__init__()
        self.encoder = make_encoder(observed, config)
        self.head = _head(config.recurrent or config.hidden, config.head, observed.actions, scale=0.01)

    def forward(self, image: Tensor, features: Tensor | None = None) -> tuple[Tensor]:
        """Return what the distribution of actions needs: unnormalized log-probabilities."""
        return self.act(self.encoder(image, features))

    def act(self, code: Tensor) -> tuple[Tensor]:
        """Return the same for a code, or a memory."""
        return (self.head(code),)


class LocalCritic(nn.Module):
    """Value `(..., N, 1)` of each agent from its own observation."""

    def __init__(self, observed: Observed, config: ModelConfig) -> None:
        """Build the encoder and the head."""
        super().__init__()
        self.encoder = make_encoder(observed, config)
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
        self.encoder = make_encoder(observed, config)
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
        self.encoder = make_encoder(observed.stacked(num_agents), config)
        size = config.recurrent or config.hidden
        self.head = _head(size, config.head, num_agents * observed.actions, scale=0.01)
        self.log_scale = nn.Parameter(torch.full((num_agents, observed.actions), -0.5))

    def forward(self, image: Tensor, features: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Return what the distribution of actions needs: the mean and the standard deviation."""
        return self.act(self.encoder(image, features))

    def act(self, code: Tensor) -> tuple[Tensor, Tensor]:
        """Return the same for a code, or a memory."""
        mean = self.head(code).unflatten(-1, self.log_scale.shape)
        return mean, self.log_scale.exp().expand_as(mean)


class RecurrentActor(nn.Module):
    """An actor with a memory: its head sees not the code of the latest observation, but a GRU's state.

    The memory is `(..., M, recurrent)`: that of each of the M = N agents, or the one of a team, M = 1.
    """

    def __init__(self, actor: Actor | TeamActor, config: ModelConfig) -> None:
        """Put the GRU between the actor's encoder and its head."""
        super().__init__()
        self.actor = actor
        self.memory = Memory(config.hidden, config.recurrent)

    def forward(
        self, memory: Tensor, is_init: Tensor, image: Tensor, features: Tensor | None = None
    ) -> tuple[Tensor, ...]:
        """Return what the distribution of actions needs, and the memory after the step; see `Memory`."""
        code = self.actor.encoder(image, features)
        memory = self.memory(code.reshape(*memory.shape[:-1], -1), memory, is_init)
        return *self.actor.act(memory.reshape(*code.shape[:-1], -1)), memory


class Memory(nn.Module):
    """A GRU (Cho et al., 2014) of each agent, all with the same weights.

    Codes `(B, M, hidden)` are one step. In TorchRL's recurrent mode, which losses set, codes `(B, T, M, hidden)` are
    T steps, of which the first alone reads its memory; the others go on from the step before.
    """

    def __init__(self, hidden: int, recurrent: int) -> None:
        """Build the GRU."""
        super().__init__()
        self.gru = GRUModule(
            hidden, recurrent, in_keys=["code", "memory", "is_init"], out_keys=["after", ("next", "memory")]
        )
        for name, weight in self.gru.gru.named_parameters():
            if name.startswith("weight"):
                nn.init.orthogonal_(weight)
            else:
                nn.init.zeros_(weight)

    def forward(self, code: Tensor, memory: Tensor, is_init: Tensor) -> Tensor:
        """Return the memory after each step, shaped as `memory`; where `is_init` (B, [T,] 1), an episode begins."""
        # TorchRL's module has no dimension of agents: their sequences become sequences of the batch.
        code, memory = code.movedim(-2, 0), memory.movedim(-2, 0).unsqueeze(-2)
        batch = code.shape[:-1]
        steps = TensorDict(code=code, memory=memory, is_init=is_init.expand(*batch, 1), batch_size=batch)
        return self.gru(steps)["after"].movedim(0, -2)


class TeamValue(nn.Module):
    """Values from all agents' stacked observations: `(..., 1)` of the team, or `(..., N, 1)` of each agent."""

    def __init__(self, observed: Observed, num_agents: int, credit: Credit, config: ModelConfig) -> None:
        """Build the encoder and the head."""
        super().__init__()
        self.encoder = make_encoder(observed.stacked(num_agents), config)
        self.shape = (1,) if credit == "team" else (num_agents, 1)
        self.head = _head(config.hidden, config.head, math.prod(self.shape), scale=1.0)

    def forward(self, image: Tensor, features: Tensor | None = None) -> Tensor:
        """Return the values."""
        return self.head(self.encoder(image, features)).unflatten(-1, self.shape)


def with_memory(actor: Actor | TeamActor, config: ModelConfig) -> nn.Module:
    """Return the actor as the configuration has it: remembering or not."""
    return RecurrentActor(actor, config) if config.recurrent else actor


def _head(size: int, hidden: tuple[int, ...], out: int, scale: float) -> nn.Sequential:
    layers: list[nn.Module] = []
    for width in hidden:
        layers += [scaled(nn.Linear(size, width)), nn.ReLU()]
        size = width
    return nn.Sequential(*layers, scaled(nn.Linear(size, out), scale))
