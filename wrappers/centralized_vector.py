"""`CentralizedVectorEnv`: a Gymnasium vector environment of B teams."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike

from mapf_pz._internal.arrays import Bools, Floats, Ints
from mapf_pz._internal.config import checked
from mapf_pz._internal.signatures import init_with_fields_of
from mapf_pz.simulator.actions import Decoder
from mapf_pz.simulator.simulator import Observation
from mapf_pz.wrappers.centralized import (
    TEAM_ACTION_MODES,
    TEAM_REWARDS,
    CentralizedConfig,
    TeamObservation,
    team_action_space,
)
from mapf_pz.wrappers.continuous_actions import generator
from mapf_pz.wrappers.simulator_vector import SimulatorVectorEnv, VectorConfig, VectorInfos, final_infos
from mapf_pz.wrappers.stacking import stacked_space


@checked
@dataclass(frozen=True)
class CentralizedVectorConfig(CentralizedConfig, VectorConfig):
    """All keywords of `CentralizedVectorEnv`: the size of the batch, and those of `centralized_env`."""


class CentralizedVectorEnv(SimulatorVectorEnv):
    """A batch of `CentralizedEnv`s, with bit-identical episodes to Gymnasium's `SyncVectorEnv` of B of them.

    Environment `b` of a batch with the seed `s` equals a single environment with the seed `s + b`. An environment whose
    episode is over is reset by the next step, which ignores its action and gives no reward. With
    `autoreset_mode="SameStep"`, the last observations and infos are in the infos as `final_obs` and `final_info`, and
    the observations are the first of the next episode.

    `gymnasium.make_vec("mapf_pz:Mapf-Centralized-v0", num_envs=B, ...)` creates it.
    """

    @init_with_fields_of(CentralizedVectorConfig)
    def __init__(self, *arguments: Any, **keywords: Any) -> None:
        """Create the environments; raises as `centralized_env`."""
        config = CentralizedVectorConfig(*arguments, **keywords)
        super().__init__(config)
        self._decode = TEAM_ACTION_MODES[config.action_mode]
        self._team_reward = TEAM_REWARDS[config.team_reward]
        self.num_envs = config.num_envs
        num_agents, num_actions = self.simulator.num_agents, self.simulator.num_actions
        self.single_observation_space = stacked_space(self.simulator.layout.space(), num_agents)
        self.single_action_space = team_action_space(config.action_mode, num_agents, num_actions)
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
        seen = self.simulator.observe()
        return self._rows(seen), self._infos(seen)

    def step(self, actions: ArrayLike) -> tuple[TeamObservation, Floats, Bools, Bools, VectorInfos]:
        """Take one step with values (B, N, A), or with integers (B, N) if `action_mode="discrete"`.

        Returns observations, rewards (B,) float64, terminated and truncated (B,) bool, infos. Raises `ValueError` for
        another shape, NaN or a number of no action, and `RuntimeError` before `reset()`.
        """
        self._require_reset()
        self._step(self._numbers(actions))
        simulator = self.simulator
        rewards = self._team_reward(simulator.agents["reward"], axis=1)  # 0 after a reset
        terminated, truncated = simulator.terminated.copy(), simulator.truncated.copy()  # never both True
        seen, final = simulator.observe(), VectorInfos()
        if self._same_step and self._over.any():
            final = final_infos(self._rows(seen), self._over, self._infos(seen, self._over))
            self._reset_over()
            seen = simulator.observe()
        return self._rows(seen), rewards, terminated, truncated, self._infos(seen) | final

    def _numbers(self, actions: ArrayLike) -> Ints:
        """Return the actions (B, N) of all agents; raises `ValueError` for wrong ones."""
        if self._decode is None:
            return self._checked(actions, self.simulator.agents.shape)
        values = np.asarray(actions, np.float64)
        if values.shape != self.action_space.shape:
            raise ValueError(f"actions: expected the shape {self.action_space.shape}, got {values.shape}")
        if np.isnan(values).any():
            raise ValueError("actions contain NaN")
        return self._decoded(values.clip(-1, 1), self._decode)

    def _decoded(self, values: Floats, decode: Decoder) -> Ints:
        """Return the actions (B, N), sampled with each environment's generator, for its active agents."""
        active = self.simulator.agents["active"]
        numbers = np.zeros(values.shape[:2], np.int64)
        for b in np.flatnonzero(~self._over):
            numbers[b, active[b]] = decode(values[b, active[b]], self._rngs[b])
        return numbers

    def _rows(self, seen: Observation) -> TeamObservation:
        """Return images (B, N * K, h, w) and, if there are any, features (B, N * F), without copying them."""
        image = seen.image.reshape(self.num_envs, -1, *seen.image.shape[-2:])
        if not self.simulator.layout.num_features:
            return image
        return {"image": image, "features": seen.features.reshape(self.num_envs, -1)}

    def _infos(self, seen: Observation, shown: Bools | None = None) -> VectorInfos:
        """Return the infos of `CentralizedEnv`, each with a mask: the environments `shown` (B,), all by default."""
        infos: VectorInfos = {"is_success": self.simulator.terminated & self._over, **self._metrics(self._over)}
        if self._decode is None:
            agents = self.simulator.agents
            gone = ~(agents["active"] | agents["was_active"])
            infos["action_mask"] = np.where(gone[:, :, None], np.int8(1), seen.action_mask)
        if self.simulator.delays is not None:
            agents = self.simulator.agents
            infos["delayed"] = agents["delayed"] & agents["was_active"]
        mask = np.ones(self.num_envs, np.bool_) if shown is None else shown
        return infos | {f"_{name}": mask.copy() for name in infos}
