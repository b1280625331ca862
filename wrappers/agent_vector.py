"""`AgentVectorEnv`: a Gymnasium vector environment in which every agent is an environment."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NoReturn

import numpy as np
from gymnasium import spaces
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike

from mapf_pz._internal.arrays import Bools, Floats
from mapf_pz._internal.signatures import init_with_fields_of
from mapf_pz.render.rgb import Picture
from mapf_pz.simulator.simulator import Observation
from mapf_pz.wrappers.simulator_vector import (
    SimulatorVectorEnv,
    VectorConfig,
    VectorInfos,
    VectorObservation,
    final_infos,
)


class AgentVectorEnv(SimulatorVectorEnv):
    """The N agents of B environments as B * N single-agent environments, which share a policy's parameters.

    | | |
    | --- | --- |
    | Observations | `(B * N, K, h, w)` float32; with `features`, a dictionary with `features`, `(B * N, F)`, too |
    | Actions | `(B * N,)` integers, each in 0 to A - 1 |
    | Rewards | `(B * N,)` float64 |
    | Ends | terminated and truncated, `(B * N,)` bool |
    | Infos | `action_mask`, `(B * N, A)` int8; `active`, `(B * N,)` bool: whether the next action is used |
    | ... at the end of an episode | `is_success` and the names of `MapfEnv.metrics()`, those of all agents together |

    Agent `i` of environment `b` is number `b * N + i`. The environments are those of `MapfEnv`: with the seed `s`,
    environment `b` equals that of the seed `s + b`, step by step.

    Agents that have disappeared (`on_target="finish"`) terminate, and are padded up to the end of their environment's
    episode: they observe zeros, are not `active`, get no reward, and are truncated when the others' episode ends.

    With `AutoresetMode.NEXT_STEP`, the step after the end of an episode resets it, ignores the actions of its agents
    and gives no reward. With `SAME_STEP`, the last observations and infos are in the infos as `final_obs` and
    `final_info`, and the observations are the first of the next episode.

    `gymnasium.make_vec("mapf_pz:Mapf-Agents-v0", num_envs=B, ...)` creates it.
    """

    @init_with_fields_of(VectorConfig)
    def __init__(self, *arguments: Any, **keywords: Any) -> None:
        """Create the environments; raises as `parallel_env`, and `ValueError` for another autoreset mode."""
        config = VectorConfig(*arguments, **keywords)
        super().__init__(config)
        self._agents_disappear = config.on_target == "finish"
        self.num_envs = config.num_envs * self.simulator.num_agents
        self.single_observation_space = self.simulator.layout.space()
        self.single_action_space = spaces.Discrete(self.simulator.num_actions)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._all = np.ones(self.num_envs, np.bool_)
        self._all.setflags(write=False)  # the masks of all infos share it

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[VectorObservation, VectorInfos]:
        """Start new episodes in all environments.

        Args:
            seed: the seed of the first of the B environments, which increases by one per environment; or B seeds, None
                for the environments that keep their generators.
            options: not supported.

        Raises `ValueError` for any options, or for a wrong number of seeds.
        """
        self._start(seed, options)
        seen = self.simulator.observe()
        return self._rows(seen), self._infos(seen)

    def render(self) -> tuple[Picture, ...] | None:
        """Return the image of each agent's environment, B * N in all; None without a render mode."""
        images = super().render()
        return images and tuple(image for image in images for _ in range(self.simulator.num_agents))

    def step(self, actions: ArrayLike) -> tuple[VectorObservation, Floats, Bools, Bools, VectorInfos]:
        """Take one step with actions (B * N,).

        Returns observations, rewards, terminated, truncated, infos. Raises `ValueError` for another shape, for numbers
        that are not whole or not in 0 to A - 1, and `RuntimeError` before `reset()`.
        """
        self._require_reset()
        self._step(self._checked(actions, (self.num_envs,)))
        agents = self.simulator.agents
        rewards = agents["reward"].reshape(-1).copy()
        terminated, truncated = agents["terminated"].flatten(), agents["truncated"].flatten()
        seen, any_over = self.simulator.observe(), bool(self._over.any())
        if any_over:
            truncated |= self._of_agents(self._over) & ~terminated  # also those that have disappeared before
        final: VectorInfos = self._metric_infos() if any_over else {}
        if self._same_step and (any_over or (self._agents_disappear and terminated.any())):
            final = self._final_infos(seen, terminated | truncated, final)
            seen = self._next_episodes(seen)
        return self._rows(seen), rewards, terminated, truncated, self._infos(seen) | final

    def _next_episodes(self, seen: Observation) -> Observation:
        """Reset the environments whose episodes are over; return what all agents observe then."""
        if self._over.any():
            self._reset_over()
            seen = self.simulator.observe()
        gone = ~self.simulator.agents["active"]
        seen.image[gone], seen.features[gone] = 0, 0
        return seen

    def _rows(self, seen: Observation) -> VectorObservation:
        """Return the observations of all agents, a row each, without copying them."""
        image = seen.image.reshape(self.num_envs, *seen.image.shape[2:])
        if not self.simulator.layout.num_features:
            return image
        return {"image": image, "features": seen.features.reshape(self.num_envs, -1)}

    def _of_agents(self, of_envs: Any) -> Any:
        """Repeat values (B,) for each agent: (B * N,)."""
        return np.repeat(of_envs, self.simulator.num_agents)

    def _infos(self, seen: Observation) -> VectorInfos:
        """Return the infos of a step, each with a mask."""
        active = (self.simulator.agents["active"] & ~self._over[:, None]).reshape(-1)
        action_mask = seen.action_mask.reshape(self.num_envs, -1)
        infos: VectorInfos = {"action_mask": action_mask, "active": active}
        if self.simulator.delays is not None:
            infos["delayed"] = self.simulator.agents["delayed"].flatten()
        return infos | dict.fromkeys((f"_{name}" for name in infos), self._all)

    def _metric_infos(self) -> VectorInfos:
        """Return the metrics of the environments whose episodes are over, each with a mask."""
        values: VectorInfos = {"is_success": self.simulator.terminated & self._over, **self._metrics(self._over)}
        infos = {name: self._of_agents(one) for name, one in values.items()}
        return infos | dict.fromkeys((f"_{name}" for name in values), self._of_agents(self._over))

    def _final_infos(self, seen: Observation, ended: Bools, metrics: VectorInfos) -> VectorInfos:
        """Return `final_obs` and `final_info` of the agents that have ended, each with a mask."""
        masks = {"action_mask": seen.action_mask.reshape(self.num_envs, -1), "_action_mask": ended}
        return final_infos(self._rows(seen), ended, masks | metrics)


def refuse_single(**_keywords: Any) -> NoReturn:
    """Raise `ValueError` for `gymnasium.make`: the environment is a vector of agents."""
    raise ValueError("Mapf-Agents-v0 is a vector environment: use gymnasium.make_vec instead of gymnasium.make")
