"""A policy that takes any action: what every other one must beat."""

from __future__ import annotations

from typing import Any

import numpy as np


class RandomPolicy:
    """Takes any action, each as likely as the others."""

    def __init__(self, num_actions: int, seed: int) -> None:
        """Choose among `num_actions` actions; `seed` decides which."""
        self._num_actions = num_actions
        self._seed = seed
        self.reset_states()

    def act(self, observations: dict[str, Any]) -> dict[str, int]:
        """Return an action for each agent that observes."""
        actions = self._rng.integers(self._num_actions, size=len(observations))
        return dict(zip(observations, actions.tolist(), strict=True))

    def reset_states(self) -> None:
        """Forget the episode: called before each."""
        self._rng = np.random.default_rng((self._seed, 1))  # another stream than the environment's
