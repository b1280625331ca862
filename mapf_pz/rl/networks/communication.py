"""Communication: agents exchange embeddings by attention, for any number of agents.

Embeddings are relative to the agent's view: what is ahead of one agent may be to the right of another. Attention
therefore takes place in the frame of the map, with vectors that are transformed there from each agent's frame and back.
Only the relative poses of two agents matter, and no tensor holds a vector for each pair of agents. This is geometric
transform attention (Miyato et al., *GTA*, ICLR 2024), which for positions alone is the rotary embedding (Su et al.,
*RoFormer*, 2021).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn.functional import scaled_dot_product_attention

from mapf_pz.instances.heading import HEADING_STEPS
from mapf_pz.rl.config import ModelConfig
from mapf_pz.rl.networks.encoders import make_encoder, scaled, widened
from mapf_pz.rl.networks.observation_shape import ObservationShape
from mapf_pz.simulator.kernels.observation.features import POSE_UNIT

HEADS = 4
"""Number of attention heads."""
_DIRECTIONS = len(HEADING_STEPS)
_WAVE_SIZE = 2 * _DIRECTIONS  # a complex number for each direction
# Complex numbers are pairs of real ones, since ONNX has no others.


@dataclass(frozen=True)
class Team:
    """The poses of B teams of N agents, as attention uses them."""

    turns: Tensor
    """(B, N, 4) int64: for each direction of the agent's view (up, right, down, left), the direction on the map."""
    phases: Tensor
    """(B, N, W, 4, 2) float32: e^(i phase) at the agent's position, of W waves in each direction on the map."""
    bias: Tensor
    """(B, heads, N, N) float32, added to the attention logits of each pair of agents; -inf: they do not communicate."""

    @classmethod
    def of_poses(cls, pose: Tensor, radius: int | None, num_waves: int) -> Team:
        """Return the team for the feature `pose` (B, N, 6).

        Each agent attends to itself and to the agents that are at most `radius` rows and columns away, None: to all.
        Agents that have disappeared observe zeros, and no other agent attends to them. In head h, the logit decreases
        by 2^-h per row or column, whichever are more (as in ALiBi: Press et al., 2022). The waves have the lengths 4,
        8, 16, ... cells.
        """
        position, headings = pose[..., :2] / POSE_UNIT, pose[..., 2:]
        distance = (position.unsqueeze(-2) - position.unsqueeze(-3)).abs().amax(-1)
        allowed = headings.sum(-1).gt(0).unsqueeze(-2).expand_as(distance)
        if radius is not None:
            allowed = allowed & (distance <= radius)
        allowed = allowed | torch.eye(distance.shape[-1], dtype=torch.bool, device=pose.device)
        slopes = 2.0 ** -torch.arange(HEADS, device=pose.device).view(-1, 1, 1)
        bias = (-slopes * distance.unsqueeze(-3)).masked_fill(~allowed.unsqueeze(-3), -math.inf)
        turns = (headings.argmax(-1, keepdim=True) + torch.arange(_DIRECTIONS, device=pose.device)) % _DIRECTIONS
        return cls(turns, _phases(position, num_waves), bias)

    def to_map(self, vectors: Tensor) -> Tensor:
        """Transform vectors (B, N, heads, D) from the agents' frames to the frame of the map.

        A vector is a complex number for each of W = D / 8 waves in four directions. The directions turn with the agent,
        and the numbers are multiplied by the waves at the agent's position.
        """
        return _product(self._turn(_waves(vectors), self.turns.argsort(-1)), self.phases.unsqueeze(2)).flatten(-3)

    def from_map(self, vectors: Tensor) -> Tensor:
        """Transform vectors back: the inverse of `to_map`."""
        real, imaginary = self.phases.unbind(-1)
        conjugate = torch.stack([real, -imaginary], -1)
        return self._turn(_product(_waves(vectors), conjugate.unsqueeze(2)), self.turns).flatten(-3)

    @staticmethod
    def _turn(waves: Tensor, directions: Tensor) -> Tensor:
        """Return the numbers of waves (B, N, heads, W, 4, 2) in these `directions` (B, N, 4)."""
        return waves.gather(-2, directions[:, :, None, None, :, None].expand_as(waves))


def _waves(vectors: Tensor) -> Tensor:
    """Return vectors (..., D) as complex numbers (..., D / 8, 4, 2)."""
    return vectors.float().unflatten(-1, (-1, _DIRECTIONS, 2))


def _product(one: Tensor, other: Tensor) -> Tensor:
    """Return the products of complex numbers (..., 2)."""
    (a, b), (c, d) = one.unbind(-1), other.unbind(-1)
    return torch.stack([a * c - b * d, a * d + b * c], -1)


def _phases(position: Tensor, num_waves: int) -> Tensor:
    """Return e^(i phase) of waves in each direction on the map, (B, N, W, 4, 2), at `position` (B, N, 2)."""
    steps = torch.as_tensor(HEADING_STEPS, device=position.device)
    along = (position.unsqueeze(-2) * steps).sum(-1)  # not a matrix product, which autocast would round
    frequencies = math.pi * 2.0 ** -torch.arange(1, num_waves + 1, device=position.device)
    phases = frequencies[:, None] * along.unsqueeze(-2)
    return torch.stack([phases.cos(), phases.sin()], -1)


class CommunicationRound(nn.Module):
    """A round of communication: a layer of a transformer with layer norms before its two parts (Xiong et al., 2020)."""

    def __init__(self, hidden: int) -> None:
        """Build the layers. At first, the round hardly changes the embeddings."""
        super().__init__()
        self.attention_norm = nn.LayerNorm(hidden)
        self.inputs = scaled(nn.Linear(hidden, 3 * hidden), 1.0)
        self.output = scaled(nn.Linear(hidden, hidden), 0.1)
        self.update = nn.Sequential(
            nn.LayerNorm(hidden), scaled(nn.Linear(hidden, hidden)), nn.ReLU(), scaled(nn.Linear(hidden, hidden), 0.1)
        )

    def forward(self, embedding: Tensor, team: Team) -> Tensor:
        """Return the embeddings (B, N, hidden) after the round."""
        query, key, value = self._projections(embedding, team)
        received = scaled_dot_product_attention(query, key, value, attn_mask=team.bias.to(query.dtype))
        embedding = embedding + self.output(team.from_map(received.transpose(-3, -2)).flatten(-2))
        return embedding + self.update(embedding)

    def attention(self, embedding: Tensor, team: Team) -> Tensor:
        """Return the weights (B, heads, N, N) of `forward`: row i has those of all agents for agent i, and sums to 1.

        The arguments are those of `forward`, whose attention does not return its weights.
        """
        query, key, _ = self._projections(embedding, team)
        logits = query @ key.transpose(-2, -1) / math.sqrt(query.shape[-1])
        return (logits + team.bias.to(query.dtype)).softmax(-1)

    def _projections(self, embedding: Tensor, team: Team) -> tuple[Tensor, Tensor, Tensor]:
        """Return the queries, keys and values (B, heads, N, D) in the frame of the map."""
        parts = self.inputs(self.attention_norm(embedding)).unflatten(-1, (3, HEADS, -1)).unbind(-3)
        query, key, value = (team.to_map(part).transpose(-3, -2) for part in parts)
        return query, key, value


class CommunicatingEncoder(nn.Module):
    """An encoder of observations, followed by rounds of communication.

    The agents' dimension is the one before the image's three. Without others in it, an agent communicates with itself.
    """

    def __init__(self, shape: ObservationShape, config: ModelConfig) -> None:
        """Build the encoder and the rounds; raises `ValueError` if the pose is not observed, or for `hidden`."""
        super().__init__()
        if shape.pose is None:
            raise ValueError(f"communication={config.communication}: expected 'pose' among the environment's features")
        if config.hidden % (HEADS * _WAVE_SIZE):
            expected = f"a multiple of {HEADS * _WAVE_SIZE} with communication"
            raise ValueError(f"hidden={config.hidden}: expected {expected}")
        self.encoder = make_encoder(shape, config)
        self.rounds = nn.ModuleList(CommunicationRound(config.hidden) for _ in range(config.communication))
        self._pose, self._radius = shape.pose, config.communication_radius

    def forward(self, image: Tensor, features: Tensor) -> Tensor:
        """Return the embeddings `(..., N, hidden)` of observations `(..., N, K, h, w)` and `(..., N, F)`."""
        embedding = self.encoder(image, features)
        lead = embedding.shape[:-2]
        pose = widened(features[..., self._pose])
        pose = pose.reshape(-1, *pose.shape[-2:])
        team = Team.of_poses(pose, self._radius, embedding.shape[-1] // (HEADS * _WAVE_SIZE))
        embedding = embedding.reshape(-1, *embedding.shape[-2:])
        for communicate in self.rounds:
            embedding = communicate(embedding, team)
        return embedding.reshape(*lead, *embedding.shape[-2:])


def make_team_encoder(shape: ObservationShape, config: ModelConfig) -> nn.Module:
    """Return the encoder that `config` names, followed by communication if the configuration has it."""
    return CommunicatingEncoder(shape, config) if config.communication else make_encoder(shape, config)
