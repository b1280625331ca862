"""Centralized control, as in the report: one policy observes all agents and acts for all of them."""

from __future__ import annotations

from typing import cast

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Bounded, Categorical, Composite, TensorSpec, Unbounded
from torchrl.data.tensor_specs import ContinuousBox
from torchrl.envs import Transform

from mapf_pz._internal.suggest import entry_of
from mapf_pz.simulator.actions import ACTION_MODES, ActionMode


class Centralize(Transform):
    """Present the group `agents` as a single agent, `team`, in addition to the group's entries.

    | key | shape | |
    | --- | --- | --- |
    | `("team", "image")` | (B, N * K, h, w) float32 | the agents' images, stacked in order |
    | `("team", "features")` | (B, N * F) float32 | with `features`: the agents' features, concatenated in order |
    | `("team", "action")` | (B, N, A) float32 | a value per agent and action, clipped to [-1, 1] |
    | `("team", "reward")` | (B, 1) float32 | the mean of the agents' rewards |
    | `("agents", "taken")` | (B, N) int64 | the discrete actions of the last step; 0 after a reset |
    """

    def __init__(self, num_actions: int, action_mode: ActionMode = "argmax", seed: int = 0) -> None:
        """Make the transform; raises `ValueError` for an unknown mode.

        Args:
            num_actions: A.
            action_mode: how the values are turned into actions; see `mapf_pz.simulator.action_modes`.
            seed: random seed of the modes that sample.
        """
        decode = entry_of("action_mode", action_mode, ACTION_MODES)
        super().__init__(
            in_keys=[("agents", "observation"), ("agents", "reward")],
            out_keys=[("team", "image"), ("team", "reward")],
            in_keys_inv=[("agents", "action")],
            out_keys_inv=[("team", "action")],
        )
        self._num_actions = num_actions
        self._decode = decode
        self._rng = np.random.default_rng(seed)

    def _stack(self, tensordict: TensorDictBase) -> TensorDictBase:
        observation = tensordict.get(("agents", "observation"))
        if isinstance(observation, Tensor):
            tensordict.set(("team", "image"), observation.flatten(-4, -3))
        else:
            tensordict.set(("team", "image"), observation.get("image").flatten(-4, -3))
            tensordict.set(("team", "features"), observation.get("features").flatten(-2))
        reward = tensordict.get(("agents", "reward"), None)
        if reward is not None:
            tensordict.set(("team", "reward"), reward.mean(-2))
        return tensordict

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        agents = tensordict_reset.get("agents")
        agents.set("taken", torch.zeros(agents.batch_size, dtype=torch.int64))
        return self._stack(tensordict_reset)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        next_tensordict.set(("agents", "taken"), tensordict.get(("agents", "action")))
        return self._stack(next_tensordict)

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        values = tensordict.get(("team", "action"), None)
        if values is not None:
            rows = values.detach().clamp(-1, 1).reshape(-1, self._num_actions).cpu().numpy().astype(np.float64)
            actions = torch.from_numpy(self._decode(rows, self._rng)).to(values.device)
            tensordict.set(("agents", "action"), actions.view(values.shape[:-1]))
        return tensordict

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Add the stacked observation and the latest discrete actions."""
        whole = cast("Composite", observation_spec)
        batch, observation = whole.shape, whole["agents", "observation"]
        taken = Categorical(self._num_actions, whole["agents"].shape, dtype=torch.int64)
        whole["agents", "taken"] = taken.to(whole.device)
        team = Composite(shape=batch)
        if isinstance(observation, Composite):
            team["image"] = _bounded(observation["image"], -4, -3)
            team["features"] = _bounded(observation["features"], -2, -1)
        else:
            team["image"] = _bounded(observation, -4, -3)
        whole["team"] = team.to(whole.device)
        return whole

    def transform_reward_spec(self, reward_spec: TensorSpec) -> TensorSpec:
        """Add the team's reward."""
        whole = cast("Composite", reward_spec)
        batch = whole.shape
        reward = Unbounded(shape=torch.Size([*batch, 1]))
        whole["team"] = Composite(reward=reward, shape=batch).to(whole.device)
        return whole

    def transform_input_spec(self, input_spec: TensorSpec) -> TensorSpec:
        """Replace the agents' actions by the team's action."""
        whole = cast("Composite", input_spec)
        batch = whole.shape
        num_agents = whole["full_action_spec", "agents", "action"].shape[-1]
        shape = torch.Size([*batch, num_agents, self._num_actions])
        action = Bounded(-1.0, 1.0, shape=shape, dtype=torch.float32)
        team = Composite(action=action, shape=batch)
        whole["full_action_spec"] = Composite(team=team, shape=batch).to(whole.device)
        return whole


def _bounded(spec: TensorSpec, first: int, last: int) -> Bounded:
    """Return the bounded spec with the dimensions `first` to `last` flattened into one."""
    bounds = cast("ContinuousBox", spec.space)
    low, high = bounds.low.flatten(first, last), bounds.high.flatten(first, last)
    return Bounded(low, high, shape=low.shape, dtype=spec.dtype, device=low.device)
