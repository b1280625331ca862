"""`CentralizedVectorEnv`: a Gymnasium vector environment of B teams."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike

from mapf_pz._internal.arrays import Bools, Floats, Ints
from mapf_pz._internal.config import checked
from mapf_pz._internal.signatures import init_with_fields_of
from mapf_pz.simulator.config import BatchConfig
from mapf_pz.wrappers.centralized import CentralizedConfig, TeamObservation, team_reward_function, team_spaces
from mapf_pz.wrappers.continuous_actions import decoder, generator
from mapf_pz.wrappers.simulator_vector import SimulatorVectorEnv, VectorInfos


@checked
@dataclass(frozen=True)
class CentralizedVectorConfig(CentralizedConfig, BatchConfig):
    """All keywords of `CentralizedVectorEnv`: the size of the batch, and those of `centralized_env`."""


class CentralizedVectorEnv(SimulatorVectorEnv):
    """A batch of `CentralizedEnv`s, with bit-identical episodes to Gymnasium's `SyncVectorEnv` of B of them.

    Environment `b` of a batch with the seed `s` equals a single environment with the seed `s + b`. An environment whose
    episode is over is reset by the next step (`AutoresetMode.NEXT_STEP`), which ignores its action and gives no reward.

    `gymnasium.make_vec("mapf_pz:Mapf-Centralized-v0", num_envs=B, ...)` creates it.
    """

    @init_with_fields_of(CentralizedVectorConfig)
    def __init__(self, *arguments: Any, **keywords: Any) -> None:
        """Create the environments; raises as `centralized_env`."""
        config = CentralizedVectorConfig(*arguments, **keywords)
        self._decode, self._team_reward = decoder(config.action_mode), team_reward_function(config.team_reward)
        super().__init__(config, AutoresetMode.NEXT_STEP)
        self.num_envs = config.num_envs
        num_agents, num_actions = self.simulator.num_agents, self.simulator.num_actions
        self.single_observation_space, self.single_action_space = team_spaces(
            self.simulator.layout.space(), num_agents, num_actions
        )
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._rngs = [np.random.default_rng() for _ in range(self.num_envs)]

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[TeamObservation, VectorInfos]:
        """Start new episodes in all environments.

        Args:
            seed: the seed of the first environment, which increases by one per environment; or one seed per
                environment, None for those that keep their generators.
            options: not supported.

        Raises `ValueError` for any options, or for a wrong number of seeds.
        """
        for b, number in self._start(seed, options).items():
            self._rngs[b] = generator(number)
        return self._observed(), self._infos(self._over)

    def step(self, actions: ArrayLike) -> tuple[TeamObservation, Floats, Bools, Bools, VectorInfos]:
        """Take one step with values (B, N, A).

        Returns observations, rewards (B,) float64, terminated and truncated (B,) bool, infos. Raises `ValueError` for
        another shape or NaN, and `RuntimeError` before `reset()`.
        """
        self._require_reset()
        values = np.asarray(actions, np.float64)
        if values.shape != self.action_space.shape:
            raise ValueError(f"actions: expected the shape {self.action_space.shape}, got {values.shape}")
        if np.isnan(values).any():
            raise ValueError("actions contain NaN")
        self._step(self._decoded(values.clip(-1, 1)))
        simulator = self.simulator
        rewards = self._team_reward(simulator.agents["reward"], axis=1)  # 0 after a reset
        terminated, truncated = simulator.terminated.copy(), simulator.truncated.copy()  # never both True
        return self._observed(), rewards, terminated, truncated, self._infos(self._over)

    def _decoded(self, values: Floats) -> Ints:
        """Return the actions (B, N), sampled with each environment's generator, for its active agents."""
        active = self.simulator.agents["active"]
        numbers = np.zeros(values.shape[:2], np.int64)
        for b in np.flatnonzero(~self._over):
            numbers[b, active[b]] = self._decode(values[b, active[b]], self._rngs[b])
        return numbers

    def _observed(self) -> TeamObservation:
        """Return images (B, N * K, h, w) and, if there are any, features (B, N * F), in new arrays."""
        seen = self.simulator.observe()
        image = seen.image.reshape(self.num_envs, -1, *seen.image.shape[-2:])
        if not self.simulator.layout.num_features:
            return image
        return {"image": image, "features": seen.features.reshape(self.num_envs, -1)}

    def _infos(self, over: Bools) -> VectorInfos:
        """Return the infos of `CentralizedEnv`, each with a mask, which is True for all environments."""
        infos: VectorInfos = {"is_success": self.simulator.terminated & over, **self._metrics(over)}
        return infos | {f"_{name}": np.ones(self.num_envs, np.bool_) for name in infos}
