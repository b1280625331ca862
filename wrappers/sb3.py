"""`AgentVecEnv`: a Stable-Baselines3 vector environment in which every agent is an environment.

This module needs Stable-Baselines3: `pip install stable-baselines3`.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvObs, VecEnvStepReturn

from mapf_pz._internal.arrays import Ints
from mapf_pz._internal.signatures import init_with_fields_of
from mapf_pz.simulator.config import BatchConfig
from mapf_pz.wrappers.agent_vector import AgentVectorEnv


class AgentVecEnv(VecEnv):
    """`AgentVectorEnv` for Stable-Baselines3: the N agents of B environments share a policy's parameters.

    At the end of an episode, the info of an agent has `terminal_observation`, `TimeLimit.truncated`, `is_success` and
    the metrics of all agents together. `sb3_contrib.MaskablePPO` finds the action masks by `action_masks`.

    Agents that have disappeared (`on_target="finish"`) stay in the batch up to the end of the others' episode, with
    observations of zeros and no reward, since Stable-Baselines3 has no masks for them.
    """

    @init_with_fields_of(BatchConfig)
    def __init__(self, *arguments: Any, **keywords: Any) -> None:
        """Create the environments; raises as `AgentVectorEnv`."""
        self.env = AgentVectorEnv(*arguments, autoreset_mode=AutoresetMode.SAME_STEP, **keywords)
        self.render_mode = self.env.render_mode
        self._action_masks: Ints = np.empty((0, 0), np.int8)
        self._actions: NDArray[Any] = np.empty(0, np.int64)
        super().__init__(self.env.num_envs, self.env.single_observation_space, self.env.single_action_space)

    def reset(self) -> VecEnvObs:
        """Start new episodes in all environments, and return the observations (B * N, ...)."""
        seeds = self._seeds[: self.env.simulator.num_envs]
        self._reset_seeds()
        observations, infos = self.env.reset(seed=seeds)
        self._action_masks = infos["action_mask"]
        return observations

    def set_options(self, options: list[dict[str, Any]] | dict[str, Any] | None = None) -> None:
        """Raise `ValueError` for any options, as `AgentVectorEnv.reset` does."""
        if any([options] if isinstance(options, dict) else options or []):
            raise ValueError(f"options={options!r}: expected none")

    def step_async(self, actions: NDArray[Any]) -> None:
        """Keep the actions (B * N,) for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Take one step; return observations, rewards (B * N,) float32, dones (B * N,) bool and infos."""
        observations, rewards, terminated, truncated, given = self.env.step(self._actions)
        self._action_masks = given["action_mask"]
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        if "final_obs" in given:
            final: dict[str, Any] = given["final_info"]
            metrics = [name for name in final if not name.startswith("_") and name != "action_mask"]
            for i in np.flatnonzero(given["_final_obs"]).tolist():
                infos[i] = {name: final[name][i].item() for name in metrics if final[f"_{name}"][i]}
                infos[i] |= {"terminal_observation": given["final_obs"][i], "TimeLimit.truncated": bool(truncated[i])}
        return observations, rewards.astype(np.float32), terminated | truncated, infos

    def action_masks(self) -> list[Ints]:
        """Return the action mask (A,) int8 of each agent, 1 for actions that the map allows."""
        return list(self._action_masks)

    def get_images(self) -> list[NDArray[np.uint8] | None]:
        """Return an image of each of the B environments, which `render` and `VecVideoRecorder` join into one."""
        return list((self.env.render() or ())[:: self.env.simulator.num_agents])

    def close(self) -> None:
        """Close the environments."""
        self.env.close()

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return an attribute for each agent; raises `AttributeError` if there is none of this name."""
        return [getattr(self, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Raise `NotImplementedError`: the environments are stepped together, so that they have no such attributes."""
        raise NotImplementedError(f"set_attr({attr_name!r}): agents have no attributes to set")

    def env_method(
        self, method_name: str, *method_args: Any, indices: VecEnvIndices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Return the `action_masks` of agents; raises `AttributeError` for another method."""
        if method_name != "action_masks":
            raise AttributeError(f"env_method({method_name!r}): expected 'action_masks'")
        masks = self.action_masks()
        return [masks[i] for i in self._get_indices(indices)]

    def env_is_wrapped(
        self, wrapper_class: type[gymnasium.Wrapper[Any, Any, Any, Any]], indices: VecEnvIndices = None
    ) -> list[bool]:
        """Return False for each agent: none is wrapped."""
        return [False for _ in self._get_indices(indices)]
