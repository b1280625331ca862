"""Actors and critics: modules that accept any leading dimensions."""

from __future__ import annotations

import math

import torch
from tensordict import TensorDict
from torch import Tensor, nn
from torchrl.modules import GRUModule

from mapf_pz.rl.config import Activation, Credit, ModelConfig
from mapf_pz.rl.networks.communication import make_team_encoder
from mapf_pz.rl.networks.encoders import make_encoder, scaled
from mapf_pz.rl.networks.observation_shape import ObservationShape

ACTIVATIONS: dict[Activation, type[nn.Module]] = {"relu": nn.ReLU, "gelu": nn.GELU, "tanh": nn.Tanh}


class Actor(nn.Module):
    """Logits `(..., A)` from one agent's own observation, for any number of agents.

    With communication, logits are `(..., N, A)`, and each agent also receives the embeddings of others.
    """

    def __init__(self, shape: ObservationShape, config: ModelConfig) -> None:
        """Build the encoder and the head."""
        super().__init__()
        self.encoder = make_team_encoder(shape, config)
        self.head = _head(config.recurrent or config.hidden, config, shape.actions, scale=0.01)

    def forward(self, image: Tensor, features: Tensor | None = None) -> tuple[Tensor, ...]:
        """Return the parameters of the action distribution, here the logits."""
        return self.act(self.encoder(image, features))

    def act(self, embedding: Tensor) -> tuple[Tensor, ...]:
        """Return the same for an embedding or a hidden state."""
        return (self.head(embedding),)

    def divide_logits(self, temperature: float) -> None:
        """Divide the logits of all observations by `temperature`, by changing the last layer."""
        with torch.no_grad():
            for parameter in self.head[-1].parameters():
                parameter /= temperature


class LocalCritic(nn.Module):
    """Value `(..., N, 1)` of each agent from its own observation, and with communication from those of others."""

    def __init__(self, shape: ObservationShape, config: ModelConfig) -> None:
        """Build the encoder and the head."""
        super().__init__()
        self.encoder = make_team_encoder(shape, config)
        self.head = _head(config.hidden, config, 1, scale=1.0)

    def forward(self, image: Tensor, features: Tensor | None = None) -> Tensor:
        """Return the values."""
        return self.head(self.encoder(image, features))


class TeamCritic(nn.Module):
    """Value `(..., N, 1)` of each agent from its own embedding and the mean embedding of the team.

    The mean over agents (Zaheer et al., *Deep Sets*, 2017) includes all agents at a cost linear in N.
    """

    def __init__(self, shape: ObservationShape, config: ModelConfig) -> None:
        """Build the encoder and the head."""
        super().__init__()
        self.encoder = make_team_encoder(shape, config)
        self.head = _head(2 * config.hidden, config, 1, scale=1.0)

    def forward(self, image: Tensor, features: Tensor | None = None) -> Tensor:
        """Return the values; the agents' dimension is the one before the image's three."""
        embedding = self.encoder(image, features)
        team = embedding.mean(-2, keepdim=True).expand_as(embedding)
        return self.head(torch.cat([embedding, team], -1))


class TeamActor(nn.Module):
    """The report's policy: mean and standard deviation `(..., N, A)` of the action matrix from stacked observations."""

    def __init__(self, shape: ObservationShape, num_agents: int, config: ModelConfig) -> None:
        """Build the encoder for N * K channels, the head, and state-independent standard deviations."""
        super().__init__()
        self.encoder = make_encoder(shape.stacked(num_agents), config)
        size = config.recurrent or config.hidden
        self.head = _head(size, config, num_agents * shape.actions, scale=0.01)
        self.log_scale = nn.Parameter(torch.full((num_agents, shape.actions), -0.5))

    def forward(self, image: Tensor, features: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Return the mean and the standard deviation of the action distribution."""
        return self.act(self.encoder(image, features))

    def act(self, embedding: Tensor) -> tuple[Tensor, Tensor]:
        """Return the same for an embedding or a hidden state."""
        mean = self.head(embedding).unflatten(-1, self.log_scale.shape)
        return mean, self.log_scale.exp().expand_as(mean)


class MatrixActor(Actor):
    """Mean and standard deviation `(..., N, A)` of the action matrix from N agents' observations, for any N.

    The agents share an encoder with communication, and each row's distribution depends on its agent's embedding. The
    mean is an actor's logits, divided by 20 because actions are clipped to [-1, 1]. The initial standard deviation is
    that of Gumbel noise, pi / sqrt(6), divided by 20: the action with the largest number of a row is then distributed
    almost as in the softmax distribution of the logits.
    """

    LOGIT_UNIT = 1 / 20

    def __init__(self, shape: ObservationShape, config: ModelConfig) -> None:
        """Build the layers of `Actor`, and state-independent standard deviations."""
        super().__init__(shape, config)
        self.log_scale = nn.Parameter(torch.full((shape.actions,), math.log(math.pi / math.sqrt(6))))

    def act(self, embedding: Tensor) -> tuple[Tensor, ...]:
        """Return the mean and the standard deviation for embeddings or hidden states."""
        mean = self.LOGIT_UNIT * self.head(embedding)
        return mean, self.LOGIT_UNIT * self.log_scale.exp().expand_as(mean)


class RecurrentActor(nn.Module):
    """A recurrent actor: the input of its head is the hidden state of a GRU instead of an observation's embedding.

    Hidden states have the shape `(..., M, recurrent)`: one per agent, M = N, or one for the team, M = 1.
    """

    def __init__(self, actor: Actor | TeamActor, config: ModelConfig) -> None:
        """Put the GRU between the actor's encoder and its head."""
        super().__init__()
        self.actor = actor
        self.core = RecurrentCore(config.hidden, config.recurrent)

    def forward(
        self, hidden_state: Tensor, is_init: Tensor, image: Tensor, features: Tensor | None = None
    ) -> tuple[Tensor, ...]:
        """Return the parameters of the action distribution, and the next hidden state; see `RecurrentCore`."""
        embedding = self.actor.encoder(image, features)
        hidden_state = self.core(embedding.reshape(*hidden_state.shape[:-1], -1), hidden_state, is_init)
        return *self.actor.act(hidden_state.reshape(*embedding.shape[:-1], -1)), hidden_state


class RecurrentCore(nn.Module):
    """A GRU (Cho et al., 2014) with one hidden state per agent, and weights shared by all agents.

    Embeddings `(B, M, hidden)` are a single step. In TorchRL's recurrent mode, which losses set, embeddings
    `(B, T, M, hidden)` are T steps; only the first one reads the given hidden state, and the others continue from the
    previous step.
    """

    def __init__(self, hidden: int, recurrent: int) -> None:
        """Build the GRU."""
        super().__init__()
        self.gru = GRUModule(
            hidden,
            recurrent,
            in_keys=["embedding", "hidden_state", "is_init"],
            out_keys=["output", ("next", "hidden_state")],
        )
        for name, weight in self.gru.gru.named_parameters():
            if name.startswith("weight"):
                nn.init.orthogonal_(weight)
            else:
                nn.init.zeros_(weight)

    def forward(self, embedding: Tensor, hidden_state: Tensor, is_init: Tensor) -> Tensor:
        """Return the hidden state after each step, shaped like `hidden_state`; `is_init` (B, [T,] 1) marks resets."""
        # TorchRL's module has no dimension for agents: it becomes the first batch dimension.
        embedding, hidden_state = embedding.movedim(-2, 0), hidden_state.movedim(-2, 0).unsqueeze(-2)
        batch = embedding.shape[:-1]
        steps = TensorDict(
            embedding=embedding, hidden_state=hidden_state, is_init=is_init.expand(*batch, 1), batch_size=batch
        )
        return self.gru(steps)["output"].movedim(0, -2)


class TeamValue(nn.Module):
    """Values from all agents' stacked observations: `(..., 1)` for the team, or `(..., N, 1)`, one per agent."""

    def __init__(self, shape: ObservationShape, num_agents: int, credit: Credit, config: ModelConfig) -> None:
        """Build the encoder and the head."""
        super().__init__()
        self.encoder = make_encoder(shape.stacked(num_agents), config)
        self.shape = (1,) if credit == "team" else (num_agents, 1)
        self.head = _head(config.hidden, config, math.prod(self.shape), scale=1.0)

    def forward(self, image: Tensor, features: Tensor | None = None) -> Tensor:
        """Return the values."""
        return self.head(self.encoder(image, features)).unflatten(-1, self.shape)


class PooledValue(LocalCritic):
    """Value `(..., 1)` of the team from the mean of the agents' embeddings, for any number of agents."""

    def forward(self, image: Tensor, features: Tensor | None = None) -> Tensor:
        """Return the values; the agents' dimension is the one before the image's three."""
        return self.head(self.encoder(image, features).mean(-2))


def make_matrix_actor(shape: ObservationShape, num_agents: int, config: ModelConfig) -> Actor | TeamActor:
    """Return the actor of a centralized policy: with communication for any number of agents, otherwise the report's."""
    return MatrixActor(shape, config) if config.communication else TeamActor(shape, num_agents, config)


def make_team_value(shape: ObservationShape, num_agents: int, credit: Credit, config: ModelConfig) -> nn.Module:
    """Return the critic of a centralized policy, with the inputs of its actor."""
    if not config.communication:
        return TeamValue(shape, num_agents, credit, config)
    return LocalCritic(shape, config) if credit == "agent" else PooledValue(shape, config)


def add_recurrence(actor: Actor | TeamActor, config: ModelConfig) -> nn.Module:
    """Return the actor, with a recurrent core if the configuration has one."""
    return RecurrentActor(actor, config) if config.recurrent else actor


def _head(size: int, config: ModelConfig, out: int, scale: float) -> nn.Sequential:
    layers: list[nn.Module] = []
    for width in config.head:
        layers += [scaled(nn.Linear(size, width)), ACTIVATIONS[config.activation]()]
        size = width
    return nn.Sequential(*layers, scaled(nn.Linear(size, out), scale))
