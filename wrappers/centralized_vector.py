"""`CentralizedVectorEnv`: a Gymnasium vector environment of B teams."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from mapf_pz._internal.arrays import Bools, Floats, Ints
from mapf_pz._internal.signatures import init_with_fields_of
from mapf_pz.simulator.config import BatchConfig, EnvConfig
from mapf_pz.simulator.simulator import Simulator
from mapf_pz.wrappers.centralized import CentralizedConfig, TeamObservation, team_reward_function, team_spaces
from mapf_pz.wrappers.continuous_actions import decoder, generator

Infos = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class CentralizedVectorConfig(CentralizedConfig, BatchConfig):
    """All keywords of `CentralizedVectorEnv`: the size of the batch, and those of `centralized_env`."""


class CentralizedVectorEnv(VectorEnv[TeamObservation, ArrayLike, NDArray[Any]]):
    """A batch of `CentralizedEnv`s, with bit-identical episodes to Gymnasium's `SyncVectorEnv` of B of them.

    Environment `b` of a batch with the seed `s` equals a single environment with the seed `s + b`. An environment whose
    episode is over is reset by the next step (`AutoresetMode.NEXT_STEP`), which ignores its action and gives no reward.

    `gymnasium.make_vec("mapf_pz:Mapf-Centralized-v0", num_envs=B, ...)` creates it.
    """

    @init_with_fields_of(CentralizedVectorConfig)
    def __init__(self, *arguments: Any, **keywords: Any) -> None:
        """Create the environments; raises as `centralized_env`."""
        config = CentralizedVectorConfig.from_keywords(*arguments, **keywords)
        num_envs = config.num_envs
        self._decode, self._team_reward = decoder(config.action_mode), team_reward_function(config.team_reward)
        self.simulator = Simulator(EnvConfig(**config.keywords()), num_envs, config.num_threads)
        self.num_envs = num_envs
        self.metadata = {"autoreset_mode": AutoresetMode.NEXT_STEP}
        num_agents, num_actions = self.simulator.num_agents, self.simulator.num_actions
        self.single_observation_space, self.single_action_space = team_spaces(
            self.simulator.layout.space(), num_agents, num_actions
        )
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._rngs = [np.random.default_rng() for _ in range(num_envs)]
        self._over = np.zeros(num_envs, np.bool_)
        self._metric_names: tuple[str, ...] = ()  # empty before the first reset

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[TeamObservation, Infos]:
        """Start new episodes in all environments.

        Args:
            seed: the seed of the first environment, which increases by one per environment; or one seed per
                environment, None for those that keep their generators.
            options: not supported.

        Raises `ValueError` for any options, or for a wrong number of seeds.
        """
        if options:
            raise ValueError(f"options={options!r}: expected none")
        seeds = [None if seed is None else seed + b for b in range(self.num_envs)] if _is_one(seed) else list(seed)
        if len(seeds) != self.num_envs:
            raise ValueError(f"seed: expected {self.num_envs} seeds, got {len(seeds)}")
        given = {b: int(number) for b, number in enumerate(seeds) if number is not None}
        for b, number in given.items():
            self._rngs[b] = generator(number)
        self.simulator.reset(seeds=given)
        self._over[:] = False
        self._metric_names = tuple(self.simulator.metrics(0))
        return self._observed(), self._infos(self._over)

    def step(self, actions: ArrayLike) -> tuple[TeamObservation, Floats, Bools, Bools, Infos]:
        """Take one step with values (B, N, A).

        Returns observations, rewards (B,) float64, terminated and truncated (B,) bool, infos. Raises `ValueError` for
        another shape or NaN, and `RuntimeError` before `reset()`.
        """
        if not self._metric_names:
            raise RuntimeError("call reset() before step()")
        values = np.asarray(actions, np.float64)
        if values.shape != self.action_space.shape:
            raise ValueError(f"actions: expected the shape {self.action_space.shape}, got {values.shape}")
        if np.isnan(values).any():
            raise ValueError("actions contain NaN")
        needs_reset, simulator = self._over, self.simulator
        self.simulator.step(self._decoded(values.clip(-1, 1)))
        if needs_reset.any():
            self.simulator.reset(np.flatnonzero(needs_reset).tolist())
        rewards = self._team_reward(simulator.agents["reward"].astype(np.float64), axis=1)  # 0 after a reset
        terminated, truncated = simulator.terminated.copy(), simulator.truncated.copy()  # never both True
        self._over = terminated | truncated
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

    def _infos(self, over: Bools) -> Infos:
        """Return the infos of `CentralizedEnv`, each with a mask, which is True for all environments."""
        metrics = {name: np.zeros(self.num_envs) for name in self._metric_names}
        for b in np.flatnonzero(over):
            for name, value in self.simulator.metrics(b).items():
                metrics[name][b] = value
        infos: Infos = {"is_success": self.simulator.terminated & over, **metrics}
        return infos | {f"_{name}": np.ones(self.num_envs, np.bool_) for name in infos}


def _is_one(seed: int | Sequence[int | None] | None) -> bool:
    return seed is None or isinstance(seed, (int, np.integer))
