"""A learned policy in a batch of environments, in which it acts by one call of its network."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import torch

from mapf_pz._internal.arrays import Bools, Floats, Ints
from mapf_pz.rl.networks.batched_network import Memory, Seen
from mapf_pz.simulator.simulator import Observation, Simulator

if TYPE_CHECKING:
    from mapf_pz.rl.policies.policy import LearnedPolicy


class LearnedBatch:
    """A learned policy in B environments of a simulator. It acts in each of them as in a single environment."""

    def __init__(self, policy: LearnedPolicy, simulator: Simulator) -> None:
        """Begin an episode in each environment.

        Raises `ValueError` if the simulator's observations have another shape than the policy's.
        """
        layout = simulator.layout
        self._has_features = layout.num_features > 0
        features = {"image": layout.image_shape, "features": (layout.num_features,)}
        policy.check("agent_0", features if self._has_features else layout.image_shape)
        self._policy = policy
        self._simulator = simulator
        self._memories = [policy.new_memory() for _ in range(simulator.num_envs)]

    def reset(self, b: int) -> None:
        """Begin an episode in environment `b`."""
        self._memories[b] = self._policy.new_memory()

    def actions(self, observation: Observation, envs: Sequence[int]) -> Ints:
        """Return actions (B, N) int64 for the current state of the simulator.

        Args:
            observation: what the agents observe in this state.
            envs: the environments to act in; in the others, actions are 0.
        """
        mask = observation.action_mask if self._policy.needs_infos else None
        seen, rows, memories = self._select(observation, mask, envs)
        actions = np.zeros(rows.shape, np.int64)
        actions[rows] = self._policy.choose(self._policy.rate(seen, memories), seen.counts, memories)
        return actions

    def preferences(self, observation: Observation, envs: Sequence[int]) -> Floats:
        """Return preferences (B, N, A) float32 over actions; none of them is masked.

        Arguments are those of `actions`. Preferences of agents that have disappeared, and in other environments, are 0.
        """
        seen, rows, memories = self._select(observation, None, envs)
        preferences = np.zeros(observation.action_mask.shape, np.float32)
        preferences[rows] = self._policy.rate(seen, memories)
        return preferences

    def _select(
        self, observation: Observation, mask: Ints | None, envs: Sequence[int]
    ) -> tuple[Seen, Bools, list[Memory]]:
        """Return what is observed in the environments `envs`, by which agents (B, N) bool, and the memories.

        Agents that have disappeared are left out.
        """
        present = self._simulator.agents["was_active"]
        chosen = sorted(envs)
        rows = np.zeros(present.shape, np.bool_)
        rows[chosen] = present[chosen]
        counts, agents = rows[chosen].sum(1).tolist(), rows.nonzero()[1].tolist()
        image = torch.from_numpy(observation.image[rows])
        features = torch.from_numpy(observation.features[rows]) if self._has_features else None
        allowed = None if mask is None else torch.from_numpy(mask[rows])
        return Seen(counts, agents, image, features, allowed), rows, [self._memories[b] for b in chosen]
