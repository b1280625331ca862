"""A learned policy in a batch of environments, in which it acts by one call of its network."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import torch

from mapf_pz.arrays import Floats, Ints
from mapf_pz.rl.batched_network import Seen
from mapf_pz.simulator import Observation, Simulator

if TYPE_CHECKING:
    from mapf_pz.rl.policy import LearnedPolicy


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
        actions = np.zeros(self._simulator.agents.shape, np.int64)
        episodes = [self._seen(observation, mask, b) for b in envs]
        memories = [self._memories[b] for b in envs]
        rated = self._policy.rate(episodes, memories)
        for b, seen, preferences, memory in zip(envs, episodes, rated, memories, strict=True):
            actions[b, seen.agents] = self._policy.choose(preferences, memory)
        return actions

    def preferences(self, observation: Observation, envs: Sequence[int]) -> Floats:
        """Return preferences (B, N, A) float32 over actions; no action is masked.

        Arguments are those of `actions`. Preferences in other environments, and of agents that have disappeared, are 0.
        """
        preferences = np.zeros(observation.action_mask.shape, np.float32)
        episodes = [self._seen(observation, None, b) for b in envs]
        rated = self._policy.rate(episodes, [self._memories[b] for b in envs])
        for b, seen, found in zip(envs, episodes, rated, strict=True):
            preferences[b, seen.agents] = found
        return preferences

    def _seen(self, observation: Observation, mask: Ints | None, b: int) -> Seen:
        """Return what the agents of environment `b` observe, other than those that have disappeared."""
        agents = np.flatnonzero(self._simulator.agents["was_active"][b])
        every = len(agents) == self._simulator.num_agents
        image, features, allowed = (
            None if part is None else torch.from_numpy(part[b] if every else part[b, agents])
            for part in (observation.image, observation.features if self._has_features else None, mask)
        )
        return Seen(agents, image, features, allowed)
