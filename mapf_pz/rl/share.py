"""`Share`: observation sharing between neighbors in the batched environment."""

from __future__ import annotations

from typing import cast

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Bounded, Composite, TensorSpec
from torchrl.data.tensor_specs import ContinuousBox
from torchrl.envs import Transform

from mapf_pz.neighbors import check_sharing, nearest


class Share(Transform):
    """Append the observations of each agent's nearest neighbors to its own: `NeighborObservations` in a batch.

    | key | shape | |
    | --- | --- | --- |
    | `("agents", "observation")` | (B, N, (1 + neighbors) * K, h, w) float32 | or its entry `image` |
    | its entry `features` | (B, N, (1 + neighbors) * F) float32 | if there are features |
    | `("agents", "position")` | (B, N, 2) int64 | read, not changed |
    """

    def __init__(self, neighbors: int, radius: int) -> None:
        """Make the transform; raises `ValueError` for negative numbers.

        Args:
            neighbors: number of neighbors whose observations each agent receives.
            radius: maximum distance of a neighbor, in rows and in columns.
        """
        check_sharing(neighbors, radius)
        super().__init__(in_keys=[("agents", "observation")], out_keys=[("agents", "observation")])
        self.neighbors, self.radius = neighbors, radius

    def _share(self, tensordict: TensorDictBase) -> TensorDictBase:
        observation = tensordict.get(("agents", "observation"))
        positions = tensordict.get(("agents", "position")).numpy()
        near = torch.from_numpy(nearest(positions, positions[..., 0] >= 0, self.neighbors, self.radius))
        if isinstance(observation, Tensor):
            shared = _with_neighbors(observation, near)
        else:
            shared = observation.apply(lambda part: _with_neighbors(part, near))
        return tensordict.set(("agents", "observation"), shared)

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        return self._share(tensordict_reset)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return self._share(next_tensordict)

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Extend the observation by the neighbors' channels and features."""
        whole = cast("Composite", observation_spec)
        whole["agents", "observation"] = self._spec(whole["agents", "observation"])
        return whole

    def _spec(self, spec: TensorSpec) -> TensorSpec:
        if isinstance(spec, Composite):
            return Composite({name: self._spec(part) for name, part in spec.items()}, shape=spec.shape)
        bounds = cast("ContinuousBox", spec.space)
        low, high = (torch.cat([bound] * (1 + self.neighbors), 2) for bound in (bounds.low, bounds.high))
        return Bounded(low, high, shape=low.shape, dtype=spec.dtype)


def _with_neighbors(observation: Tensor, near: Tensor) -> Tensor:
    """Append to `observation` (B, N, K, ...) those of the agents `near` (B, N, k), with zeros for the index -1."""
    shared = observation[torch.arange(len(observation)).view(-1, 1, 1), near]
    shared[near < 0] = 0
    return torch.cat([observation, shared.flatten(2, 3)], 2)
