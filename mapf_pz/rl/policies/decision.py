"""What a trained policy computes in a step, for those who study it: see `LearnedPolicy.watch`."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import NamedTuple

from torch import Tensor, nn

from mapf_pz._internal.arrays import Floats
from mapf_pz.rl.networks.communication import CommunicationRound, Team


class Decision(NamedTuple):
    """What a policy computed in a step for R agents."""

    agents: Sequence[Hashable]
    """(R,): the agents' names."""
    preferences: Floats
    """(R, A) float32: the sampled preferences, higher for better actions."""
    attention: Floats | None
    """(R, R) float32: for each agent the weights of all agents, itself included, in the last round of communication.
    They are means over the attention heads, and sum to 1. None: the agents do not communicate."""
    probabilities: Floats | None = None
    """(R, A) float32: the probability of each action, at the policy's temperature. None: it has no closed form."""
    means: Floats | None = None
    """(R, A) float32: the means of the distribution of preferences, of a policy without probabilities."""


class AttentionRecorder:
    """Keeps the attention of a network's last round of communication, whenever the network is called."""

    def __init__(self, network: nn.Module) -> None:
        """Begin with the next call of the network, whose outputs do not change."""
        self.weights: Floats | None = None
        """(N, N): the weights in the first team of the last call, means over heads. None: there are no rounds."""
        rounds = [module for module in network.modules() if isinstance(module, CommunicationRound)]
        if rounds:
            rounds[-1].register_forward_hook(self._keep)

    def _keep(self, last: nn.Module, inputs: tuple[Tensor, Team], embedding: Tensor) -> None:
        assert isinstance(last, CommunicationRound)
        self.weights = last.attention(*inputs)[0].mean(0).numpy()
