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

from mapf_pz.instances.heading import HEADING_STEPS
from mapf_pz.rl.config import ModelConfig
from mapf_pz.rl.networks.encoders import make_encoder, scaled, widened
from mapf_pz.rl.networks.observation_shape import ObservationShape
from mapf_pz.simulator.kernels.observation.features import POSE_UNIT

HEADS = 4
"""Number of attention heads."""
MAX_CONFLICT_DISTANCE = 2
"""Largest number of moves between two agents whose moves can conflict: both may move to the cell between them."""
_DIRECTIONS = len(HEADING_STEPS)
_WAVE_SIZE = 2 * _DIRECTIONS  # a complex number for each direction


@dataclass(frozen=True)
class Team:
    """The poses of B teams of N agents, as attention uses them."""

    turns: Tensor
    """(B, N, 4) int64: for each direction of the agent's view (up, right, down, left), the direction on the map."""
    phases: Tensor
    """(B, N, 1, W, 4) complex64: e^(i phase) at the agent's position, of W waves in each direction on the map."""
    bias: Tensor
    """(B, heads, N, N) float32, added to the attention logits of each pair of agents; -inf: they do not communicate."""
    offsets: Tensor
    """(B, N, N, 2) float32: the rows and columns between each two agents."""
    present: Tensor
    """(B, N) bool: False for agents that have disappeared."""

    @classmethod
    def of_poses(cls, pose: Tensor, radius: int | None, num_waves: int) -> Team:
        """Return the team for the feature `pose` (B, N, 6).

        Each agent attends to itself and to the agents that are at most `radius` rows and columns away, None: to all.
        Agents that have disappeared observe zeros, and no other agent attends to them. In head h, the logit decreases
        by 2^-h per row or column, whichever are more (as in ALiBi: Press et al., 2022). The waves have the lengths 4,
        8, 16, ... cells.
        """
        position, headings = pose[..., :2] / POSE_UNIT, pose[..., 2:]
        offsets = (position.unsqueeze(-2) - position.unsqueeze(-3)).abs()
        distance, present = offsets.amax(-1), headings.sum(-1).gt(0)
        allowed = present.unsqueeze(-2).expand_as(distance)
        if radius is not None:
            allowed = allowed & (distance <= radius)
        allowed = allowed | torch.eye(distance.shape[-1], dtype=torch.bool, device=pose.device)
        slopes = 2.0 ** -torch.arange(HEADS, device=pose.device).view(-1, 1, 1)
        bias = (-slopes * distance.unsqueeze(-3)).masked_fill(~allowed.unsqueeze(-3), -math.inf)
        turns = (headings.argmax(-1, keepdim=True) + torch.arange(_DIRECTIONS, device=pose.device)) % _DIRECTIONS
        return cls(turns, _phases(position, num_waves), bias, offsets, present)

    def near(self) -> Tensor:
        """Return whether the moves of two agents can conflict, (B, N, N) bool: they are at most two moves apart."""
        return self.present.unsqueeze(-2) & (self.offsets.sum(-1) <= MAX_CONFLICT_DISTANCE)

    def to_map(self, vectors: Tensor) -> Tensor:
        """Transform vectors (B, N, V, D) from the agents' frames to the frame of the map.

        A vector is a complex number for each of W = D / 8 waves in four directions. The directions turn with the agent,
        and the numbers are multiplied by the waves at the agent's position.
        """
        return _times(self._turn(vectors, self.turns.argsort(-1)), self.phases)

    def from_map(self, vectors: Tensor) -> Tensor:
        """Transform vectors back: the inverse of `to_map`."""
        return self._turn(_times(vectors, self.phases.conj()), self.turns)

    @staticmethod
    def _turn(vectors: Tensor, directions: Tensor) -> Tensor:
        """Return vectors (B, N, V, D) with their numbers in these `directions` (B, N, 4)."""
        waves = vectors.unflatten(-1, (-1, _WAVE_SIZE))  # pairs of real numbers, since in ONNX only those are gathered
        pairs = torch.stack([2 * directions, 2 * directions + 1], -1).flatten(-2)
        return waves.gather(-1, pairs[:, :, None, None].expand_as(waves)).flatten(-2)


def _times(vectors: Tensor, phases: Tensor) -> Tensor:
    """Return vectors (B, N, V, D), as complex numbers, times the waves (B, N, 1, W, 4)."""
    waves = torch.view_as_complex(vectors.float().unflatten(-1, (-1, _DIRECTIONS, 2)))
    return torch.view_as_real(waves * phases).flatten(-3)


def _phases(position: Tensor, num_waves: int) -> Tensor:
    """Return e^(i phase) of waves in each direction on the map, (B, N, 1, W, 4), at `position` (B, N, 2)."""
    steps = torch.as_tensor(HEADING_STEPS, device=position.device)
    along = (position.unsqueeze(-2) * steps).sum(-1)  # not a matrix product, which autocast would round
    frequencies = math.pi * 2.0 ** -torch.arange(1, num_waves + 1, device=position.device)
    phases = frequencies[:, None] * along[:, :, None, None]
    return torch.complex(phases.cos(), phases.sin())


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
        received = _attention(query, key, team) @ value
        embedding = embedding + self.output(team.from_map(received.transpose(-3, -2)).flatten(-2))
        return embedding + self.update(embedding)

    def attention(self, embedding: Tensor, team: Team) -> Tensor:
        """Return the weights (B, heads, N, N) of `forward`: row i has those of all agents for agent i, and sums to 1.

        The arguments are those of `forward`.
        """
        query, key, _ = self._projections(embedding, team)
        return _attention(query, key, team)

    def _projections(self, embedding: Tensor, team: Team) -> tuple[Tensor, Tensor, Tensor]:
        """Return the queries, keys and values (B, heads, N, D) in the frame of the map."""
        parts = team.to_map(self.inputs(self.attention_norm(embedding)).unflatten(-1, (3 * HEADS, -1)))
        query, key, value = parts.transpose(-3, -2).split(HEADS, -3)
        return query, key, value


def _attention(query: Tensor, key: Tensor, team: Team) -> Tensor:
    """Return the attention weights (B, heads, N, N) of queries and keys (B, heads, N, D).

    The fused `scaled_dot_product_attention` is not faster for so few agents, and its gradient in mixed precision is ten
    times as slow on a CPU.
    """
    logits = query @ key.transpose(-2, -1) / math.sqrt(query.shape[-1])
    return (logits + team.bias).softmax(-1)


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
        self._num_waves = config.hidden // (HEADS * _WAVE_SIZE)

    def forward(self, image: Tensor, features: Tensor) -> Tensor:
        """Return the embeddings `(..., N, hidden)` of observations `(..., N, K, h, w)` and `(..., N, F)`."""
        return self.communicate(self.encoder(image, features), self.team(features))

    def team(self, features: Tensor) -> Team:
        """Return the teams of agents with the features `(..., N, F)`; all dimensions before N become one."""
        pose = widened(features[..., self._pose])
        return Team.of_poses(pose.reshape(-1, *pose.shape[-2:]), self._radius, self._num_waves)

    def communicate(self, embedding: Tensor, team: Team) -> Tensor:
        """Return the embeddings `(..., N, hidden)` after all rounds."""
        lead = embedding.shape[:-2]
        embedding = embedding.reshape(-1, *embedding.shape[-2:])
        for communicate in self.rounds:
            embedding = communicate(embedding, team)
        return embedding.reshape(*lead, *embedding.shape[-2:])


def make_team_encoder(shape: ObservationShape, config: ModelConfig) -> nn.Module:
    """Return the encoder that `config` names, followed by communication if the configuration has it."""
    return CommunicatingEncoder(shape, config) if config.communication else make_encoder(shape, config)
