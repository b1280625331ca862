"""Actors that decide in rounds: later decisions depend on earlier ones.

If each agent samples its action by itself, two agents for which either order is equally good both go, or both wait,
half of the time. If one decides first and the other observes it, the actions of all agents are a sample of a joint
distribution. The order of decisions is free, as in order-agnostic autoregressive models (Hoogeboom et al.,
*Autoregressive Diffusion Models*, ICLR 2022): the network learns from states in which any agents have decided. Several
agents decide in the same round, those first that are most certain (Chang et al., *MaskGIT*, CVPR 2022). In DMM
(Cognitive AI Systems, 2026), agents of MAPF also exchange their intended actions in rounds.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from mapf_pz.rl.config import ModelConfig
from mapf_pz.rl.environments.execution import sampled_preferences
from mapf_pz.rl.networks.actors import Actor
from mapf_pz.rl.networks.communication import CommunicatingEncoder, Team
from mapf_pz.rl.networks.observation_shape import ObservationShape


class JointActor(Actor):
    """Logits `(..., N, A)` of agents of which some have decided; they observe each other's decisions."""

    encoder: CommunicatingEncoder

    def __init__(self, shape: ObservationShape, config: ModelConfig) -> None:
        """Build the layers of `Actor`, and embeddings of decisions.

        Raises `ValueError` without communication, and with `mask_actions`.
        """
        if not config.communication or config.mask_actions:
            expected = "1 without communication, and with mask_actions"
            raise ValueError(f"decision_rounds={config.decision_rounds}: expected {expected}")
        super().__init__(shape, config)
        self.undecided = shape.actions
        """In place of the action of an agent that has not decided."""
        self.decision = nn.Embedding(shape.actions + 1, config.hidden)
        nn.init.zeros_(self.decision.weight)

    def forward(
        self, image: Tensor, features: Tensor | None = None, decided: Tensor | None = None
    ) -> tuple[Tensor, ...]:
        """Return the logits; `decided` (..., N) int64 are actions or `undecided`. None: all agents are undecided."""
        assert features is not None  # they include the pose
        embedding = self.encoder.encoder(image, features)
        decided = self.no_decisions(embedding) if decided is None else decided
        return self.decide(embedding, self.encoder.team(features), decided)

    def no_decisions(self, embedding: Tensor) -> Tensor:
        """Return decisions (..., N) of agents with embeddings `(..., N, hidden)` that are all undecided."""
        return torch.full_like(embedding[..., 0], self.undecided, dtype=torch.int64)

    def decide(self, embedding: Tensor, team: Team, decided: Tensor) -> tuple[Tensor, ...]:
        """Return the logits for embeddings `(..., N, hidden)` of the observations of a team."""
        return self.act(self.encoder.communicate(embedding + self.decision(decided), team))


class DecisionRounds(nn.Module):
    """Samples the actions of all agents in rounds.

    In each round, an agent decides if no undecided agent that is more certain is near enough for a conflict; in the
    last round, all others decide. The rounds end when all have decided.
    """

    def __init__(self, actor: JointActor, rounds: int, temperature: float) -> None:
        """Sample from an actor's distribution p, or from the one proportional to p^(1 / temperature)."""
        super().__init__()
        self.actor = actor
        self._rounds, self._temperature = rounds, temperature

    def forward(self, image: Tensor, features: Tensor, noise: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Return logits and preferences `(..., N, A)`: the agents' actions are those that they prefer.

        Args:
            image: the images `(..., N, K, h, w)`.
            features: the features `(..., N, F)`.
            noise: `(..., N, A)`, as in `sampled_preferences`; None: it is sampled by torch's generator.
        """
        undecided = self.actor.undecided
        embedding, team = self.actor.encoder.encoder(image, features), self.actor.encoder.team(features)
        decided = self.actor.no_decisions(embedding)
        near = team.near().reshape(*decided.shape, -1)
        logits = embedding.new_zeros((*decided.shape, undecided))
        preferences = noise = torch.empty_like(logits).exponential_() if noise is None else noise
        for _ in range(self._rounds):
            waiting = decided == undecided
            if not torch.compiler.is_exporting() and not waiting.any():  # an exported graph has no branches
                break
            (latest,) = self.actor.decide(embedding, team, decided)
            logits = torch.where(waiting.unsqueeze(-1), latest.float(), logits)
            preferences = sampled_preferences(logits, self._temperature, noise)
            certainty = torch.where(waiting, logits.softmax(-1).amax(-1), 0.0)
            deciding = waiting & ~(near & _precedes(certainty)).any(-1)
            decided = torch.where(deciding, preferences.argmax(-1), decided)
        return logits, preferences


def _precedes(certainty: Tensor) -> Tensor:
    """Return in row i which agents are more certain than agent i, (..., N, N); of equal ones, the first agent is."""
    numbers = torch.arange(certainty.shape[-1], device=certainty.device)
    one, other = certainty.unsqueeze(-1), certainty.unsqueeze(-2)
    return (other > one) | ((other == one) & (numbers < numbers.unsqueeze(-1)))


def random_decisions(actions: Tensor, known: Tensor, rounds: int, undecided: int) -> Tensor:
    """Return decisions (S, N) of random agents: in each state of 0, 1, ..., or rounds - 1 of as many shares of them.

    Args:
        actions: (S, N) int64: the agents' actions in S states.
        known: (S, N) bool: which actions are known; other agents remain undecided.
        rounds: the number of rounds.
        undecided: in place of the action of an agent that has not decided.
    """
    share = torch.randint(rounds, (len(actions), 1), device=actions.device) / rounds
    return actions.masked_fill(~known | (torch.rand(actions.shape, device=actions.device) >= share), undecided)
