"""A random policy, as a baseline."""

from __future__ import annotations

from typing import Any

import numpy as np


class RandomPolicy:
    """Samples actions uniformly."""

    def __init__(self, num_actions: int, seed: int) -> None:
        """Create a policy with `num_actions` actions and a random seed."""
        self._num_actions = num_actions
        self._seed = seed
        self.reset_states()

    def act(self, observations: dict[str, Any]) -> dict[str, int]:
        """Return an action for each agent in `observations`."""
        actions = self._rng.integers(self._num_actions, size=len(observations))
        return dict(zip(observations, actions.tolist(), strict=True))

    def reset_states(self) -> None:
        """Reset all per-episode state. Called before each episode."""
        self._rng = np.random.default_rng((self._seed, 1))  # not the environment's stream
