"""Stable-Baselines3 vector environments: `AgentVecEnv`, whose environments are agents, and `CentralizedVecEnv`.

This module needs Stable-Baselines3: `pip install stable-baselines3`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvObs, VecEnvStepReturn

from mapf_pz._internal.arrays import Ints
from mapf_pz._internal.config import checked
from mapf_pz._internal.signatures import init_with_fields_of
from mapf_pz.simulator.config import BatchConfig
from mapf_pz.wrappers.agent_vector import AgentVectorEnv
from mapf_pz.wrappers.centralized import CentralizedConfig
from mapf_pz.wrappers.centralized_vector import CentralizedVectorEnv
from mapf_pz.wrappers.simulator_vector import SimulatorVectorEnv, VectorInfos


class SimulatorVecEnv(VecEnv):
    """A vector environment of this package for Stable-Baselines3.

    At the end of an episode, the info of an environment has `terminal_observation`, `TimeLimit.truncated`, `is_success`
    and the metrics of the team. `sb3_contrib.MaskablePPO` finds the masks of discrete actions by `action_masks`.
    """

    def __init__(self, env: AgentVectorEnv | CentralizedVectorEnv) -> None:
        """Wrap `env`, which resets episodes in the step that ends them."""
        self.env = env
        self.render_mode = env.render_mode
        self._action_masks: Ints | None = None
        self._actions: NDArray[Any] = np.empty(0, np.int64)
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)

    def reset(self) -> VecEnvObs:
        """Start new episodes in all environments, and return the observations."""
        seeds = self._seeds[: self.env.simulator.num_envs]
        self._reset_seeds()
        observations, infos = self.env.reset(seed=seeds)
        self._keep_masks(infos)
        return observations

    def set_options(self, options: list[dict[str, Any]] | dict[str, Any] | None = None) -> None:
        """Raise `ValueError` for any options, as the vector environment's `reset` does."""
        if any([options] if isinstance(options, dict) else options or []):
            raise ValueError(f"options={options!r}: expected none")

    def step_async(self, actions: NDArray[Any]) -> None:
        """Keep the actions for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Take one step; return observations, rewards float32, dones bool and infos."""
        observations, rewards, terminated, truncated, given = self.env.step(self._actions)
        self._keep_masks(given)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        if "final_obs" in given:
            final: dict[str, Any] = given["final_info"]
            metrics = [name for name in final if not name.startswith("_") and name != "action_mask"]
            for i in np.flatnonzero(given["_final_obs"]).tolist():
                infos[i] = {name: final[name][i].item() for name in metrics if final[f"_{name}"][i]}
                infos[i] |= {"terminal_observation": given["final_obs"][i], "TimeLimit.truncated": bool(truncated[i])}
        return observations, rewards.astype(np.float32), terminated | truncated, infos

    def action_masks(self) -> Ints:
        """Return the masks of discrete actions, int8, 1 for actions that the map allows.

        Their shape is (B * N, A) for agents and (B, N * A) for teams. Raises `RuntimeError` before `reset()`, and for
        the matrix of a team, which has no masks.
        """
        if self._action_masks is None:
            raise RuntimeError("action_masks(): expected discrete actions, and reset() before")
        return self._action_masks

    def _keep_masks(self, infos: VectorInfos) -> None:
        masks = infos.get("action_mask")
        self._action_masks = None if masks is None else masks.reshape(self.num_envs, -1)

    def get_images(self) -> list[NDArray[np.uint8] | None]:
        """Return an image of each team, which `render` and `VecVideoRecorder` join into one."""
        return list(SimulatorVectorEnv.render(self.env) or ())

    def close(self) -> None:
        """Close the environments."""
        self.env.close()

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return an attribute for each environment; raises `AttributeError` if there is none of this name."""
        return [getattr(self, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Raise `NotImplementedError`: the environments are stepped together, so that they have no such attributes."""
        raise NotImplementedError(f"set_attr({attr_name!r}): environments have no attributes to set")

    def env_method(
        self, method_name: str, *method_args: Any, indices: VecEnvIndices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Return the `action_masks` of environments; raises `AttributeError` for another method."""
        if method_name != "action_masks":
            raise AttributeError(f"env_method({method_name!r}): expected 'action_masks'")
        masks = self.action_masks()
        return [masks[i] for i in self._get_indices(indices)]

    def env_is_wrapped(
        self, wrapper_class: type[gymnasium.Wrapper[Any, Any, Any, Any]], indices: VecEnvIndices = None
    ) -> list[bool]:
        """Return False for each environment: none is wrapped."""
        return [False for _ in self._get_indices(indices)]


class AgentVecEnv(SimulatorVecEnv):
    """`AgentVectorEnv` for Stable-Baselines3: the N agents of B environments share a policy's parameters.

    Agents that have disappeared (`on_target="finish"`) stay in the batch up to the end of the others' episode, with
    observations of zeros and no reward, since Stable-Baselines3 has no masks for them.
    """

    @init_with_fields_of(BatchConfig)
    def __init__(self, *arguments: Any, **keywords: Any) -> None:
        """Create the environments; raises as `AgentVectorEnv`."""
        super().__init__(AgentVectorEnv(*arguments, autoreset_mode=AutoresetMode.SAME_STEP, **keywords))


@checked
@dataclass(frozen=True)
class CentralizedVecConfig(CentralizedConfig, BatchConfig):
    """All keywords of `CentralizedVecEnv`."""


class CentralizedVecEnv(SimulatorVecEnv):
    """`CentralizedVectorEnv` for Stable-Baselines3: B teams, each of which is an environment.

    `sb3_contrib.MaskablePPO` needs `action_mode="discrete"`.
    """

    @init_with_fields_of(CentralizedVecConfig)
    def __init__(self, *arguments: Any, **keywords: Any) -> None:
        """Create the environments; raises as `CentralizedVectorEnv`."""
        super().__init__(CentralizedVectorEnv(*arguments, autoreset_mode=AutoresetMode.SAME_STEP, **keywords))
