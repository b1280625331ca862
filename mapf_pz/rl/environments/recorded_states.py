"""The states of environments as entries of a batch."""

from __future__ import annotations

from typing import cast

import numpy as np
import torch
from tensordict import TensorDictBase
from torchrl.data import Composite, TensorSpec, Unbounded
from torchrl.envs import Transform

from mapf_pz._internal.arrays import Bools
from mapf_pz.guidance.library import random_share
from mapf_pz.rl.environments.execution import simulator_of
from mapf_pz.simulator.states import FIELDS, States

ENTRIES = ("free", "weight", "time", "agents", "history")
"""The fields of `States`, which are the entries of `state`."""


class RecordStates(Transform):
    """Add the states of all environments: `("state", NAME)` for each field of `States`, maps as uint8."""

    def __init__(self) -> None:
        """Create the transform."""
        super().__init__(in_keys=[], out_keys=[("state", name) for name in ENTRIES])

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        return self._with_states(tensordict_reset)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return self._with_states(next_tensordict)

    def _with_states(self, tensordict: TensorDictBase) -> TensorDictBase:
        states = simulator_of(self).states()
        for name, values in zip(ENTRIES, states, strict=True):
            array = values.view(np.uint8) if name == "free" else values
            tensordict.set(("state", name), torch.from_numpy(array))
        return tensordict

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Add the states."""
        whole = cast("Composite", observation_spec)
        simulator = simulator_of(self)
        num_envs, num_agents = simulator.agents.shape
        length = simulator.config.num_last_actions
        planes = 5 if random_share(simulator.config.edge_weights) else 0
        shapes = {
            "free": ((num_envs, *simulator.shape), torch.uint8),
            "weight": ((num_envs, planes, *simulator.shape), torch.float32),
            "time": ((num_envs,), torch.int32),
            "agents": ((num_envs, num_agents, len(FIELDS)), torch.int32),
            "history": ((num_envs, num_agents, length, 2), torch.int8),
        }
        entries = {name: Unbounded(shape=torch.Size(shape), dtype=dtype) for name, (shape, dtype) in shapes.items()}
        whole["state"] = Composite(entries, shape=torch.Size([num_envs])).to(whole.device)
        return whole


def states_of(batch: TensorDictBase, kept: Bools) -> States:
    """Return the states of the environment steps of a batch that are `kept` (E,), in new arrays."""
    flat = batch.get("state").reshape(-1)
    free, weight, time, agents, history = (flat.get(name).cpu().numpy()[kept] for name in ENTRIES)
    return States(free.view(np.bool_), weight, time, agents, history)
