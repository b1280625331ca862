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

from mapf_pz.actions import HEADING_STEPS
from mapf_pz.core.observation.features import POSE_UNIT
from mapf_pz.rl.config import ModelConfig
from mapf_pz.rl.encoders import make_encoder, scaled
from mapf_pz.rl.observation_shape import ObservationShape

HEADS = 4
"""Number of attention heads."""
_DIRECTIONS = len(HEADING_STEPS)
_WAVE_SIZE = 2 * _DIRECTIONS  # a complex number for each direction


@dataclass(frozen=True)
class Team:
    """The poses of B teams of N agents, as attention uses them."""

    position: Tensor
    """(B, N, 2) float32: [row, col]."""
    heading: Tensor
    """(B, N) int64: the `Heading` that is up in the agent's view."""
    bias: Tensor
    """(B, heads, N, N) float32, added to the attention logits of each pair of agents; -inf: they do not communicate."""

    @classmethod
    def of_poses(cls, pose: Tensor, radius: int | None) -> Team:
        """Return the team for the feature `pose` (B, N, 6).

        Each agent attends to itself and to the agents that are at most `radius` rows and columns away, None: to all.
        Agents that have disappeared observe zeros, and no other agent attends to them. In head h, the logit decreases
        by 2^-h per row or column, whichever are more (as in ALiBi: Press et al., 2022).
        """
        position, headings = pose[..., :2] / POSE_UNIT, pose[..., 2:]
        distance = (position.unsqueeze(-2) - position.unsqueeze(-3)).abs().amax(-1)
        allowed = headings.sum(-1).gt(0).unsqueeze(-2).expand_as(distance)
        if radius is not None:
            allowed = allowed & (distance <= radius)
        allowed = allowed | torch.eye(distance.shape[-1], dtype=torch.bool, device=pose.device)
        slopes = 2.0 ** -torch.arange(HEADS, device=pose.device).view(-1, 1, 1)
        bias = (-slopes * distance.unsqueeze(-3)).masked_fill(~allowed.unsqueeze(-3), -math.inf)
        return cls(position, headings.argmax(-1), bias)

    def to_map(self, vectors: Tensor) -> Tensor:
        """Transform vectors (B, N, heads, D) from the agents' frames to the frame of the map.

        A vector is D / 8 waves in each of four directions, each of two numbers, a complex number. The directions turn
        with the agent, and each number is rotated by the wave's phase at the agent's position.
        """
        turned = self._turn(vectors.unflatten(-1, (-1, _DIRECTIONS, 2)), -self.heading)
        return _rotate(turned, self._phases(turned)).flatten(-3)

    def from_map(self, vectors: Tensor) -> Tensor:
        """Transform vectors back: the inverse of `to_map`."""
        waves = vectors.unflatten(-1, (-1, _DIRECTIONS, 2))
        return self._turn(_rotate(waves, -self._phases(waves)), self.heading).flatten(-3)

    @staticmethod
    def _turn(waves: Tensor, number: Tensor) -> Tensor:
        """Turn the directions of waves (B, N, heads, W, 4, 2) by `number` (B, N) quarter turns to the left."""
        index = (torch.arange(_DIRECTIONS, device=number.device) + number.unsqueeze(-1)) % _DIRECTIONS
        return waves.gather(-2, index[:, :, None, None, :, None].expand_as(waves))

    def _phases(self, waves: Tensor) -> Tensor:
        """Return the phases (B, N, 1, W, 4) of waves of 4, 8, 16, ... cells at the agents' positions."""
        steps = torch.as_tensor(HEADING_STEPS, device=self.position.device)
        along = (self.position.unsqueeze(-2) * steps).sum(-1)  # not a matrix product, which autocast would round
        frequencies = math.pi * 2.0 ** -torch.arange(1, waves.shape[-3] + 1, device=self.position.device)
        return frequencies[:, None] * along[:, :, None, None, :]


def _rotate(waves: Tensor, phases: Tensor) -> Tensor:
    """Rotate complex numbers, pairs in the last dimension, by `phases`."""
    real, imaginary = waves.unbind(-1)
    sine, cosine = phases.sin(), phases.cos()
    return torch.stack([real * cosine - imaginary * sine, real * sine + imaginary * cosine], -1)


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
        parts = self.inputs(self.attention_norm(embedding)).unflatten(-1, (3, HEADS, -1)).unbind(-3)
        query, key, value = (team.to_map(part).transpose(-3, -2) for part in parts)
        received = scaled_dot_product_attention(query, key, value, attn_mask=team.bias.to(query.dtype))
        embedding = embedding + self.output(team.from_map(received.transpose(-3, -2)).flatten(-2))
        return embedding + self.update(embedding)


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
        team = Team.of_poses(features[..., self._pose].reshape(-1, *features.shape[-2:-1], 6), self._radius)
        embedding = embedding.reshape(-1, *embedding.shape[-2:])
        for communicate in self.rounds:
            embedding = communicate(embedding, team)
        return embedding.reshape(*lead, *embedding.shape[-2:])


def make_team_encoder(shape: ObservationShape, config: ModelConfig) -> nn.Module:
    """Return the encoder that `config` names, followed by communication if the configuration has it."""
    return CommunicatingEncoder(shape, config) if config.communication else make_encoder(shape, config)
