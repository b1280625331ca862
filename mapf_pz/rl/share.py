"""`Share`: agents of the batched environment that also observe what their neighbors observe."""

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
    | `("agents", "observation")` | (B, N, (1 + neighbors) * K, h, w) float32 | `image`, where it has entries |
    | ... its entry `features` | (B, N, (1 + neighbors) * F) float32 | |
    | `("agents", "position")` | (B, N, 2) int64 | read, and left as it is |
    """

    def __init__(self, neighbors: int, radius: int) -> None:
        """Make the transform; raises `ValueError` for negative numbers.

        Args:
            neighbors: how many others' observations each agent gets.
            radius: how many rows, and how many columns, away a neighbor may be.
        """
        check_sharing(neighbors, radius)
        super().__init__(in_keys=[("agents", "observation")], out_keys=[("agents", "observation")])
        self.neighbors, self.radius = neighbors, radius

    def _share(self, tensordict: TensorDictBase) -> TensorDictBase:
        seen, positions = tensordict.get(("agents", "observation")), tensordict.get(("agents", "position")).numpy()
        near = torch.from_numpy(nearest(positions, positions[..., 0] >= 0, self.neighbors, self.radius))
        if isinstance(seen, Tensor):
            shared = _with_neighbors(seen, near)
        else:
            shared = seen.apply(lambda part: _with_neighbors(part, near))
        return tensordict.set(("agents", "observation"), shared)

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        return self._share(tensordict_reset)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return self._share(next_tensordict)

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Make room for the neighbors' planes and features."""
        whole = cast("Composite", observation_spec)
        whole["agents", "observation"] = self._spec(whole["agents", "observation"])
        return whole

    def _spec(self, spec: TensorSpec) -> TensorSpec:
        if isinstance(spec, Composite):
            return Composite({name: self._spec(part) for name, part in spec.items()}, shape=spec.shape)
        bounds = cast("ContinuousBox", spec.space)
        low, high = (torch.cat([bound] * (1 + self.neighbors), 2) for bound in (bounds.low, bounds.high))
        return Bounded(low, high, shape=low.shape, dtype=spec.dtype)


def _with_neighbors(seen: Tensor, near: Tensor) -> Tensor:
    """Return (B, N, (1 + k) * K, ...): `seen` (B, N, K, ...), then that of agents `near` (B, N, k); for -1, zeros."""
    theirs = seen[torch.arange(len(seen)).view(-1, 1, 1), near]
    theirs[near < 0] = 0
    return torch.cat([seen, theirs.flatten(2, 3)], 2)
