"""What the configured channels and features amount to: shapes, Gymnasium spaces, and the kernels' geometry."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces

from mapf_pz.actions import Action, CardinalAction
from mapf_pz.arrays import Floats
from mapf_pz.config import EnvConfig
from mapf_pz.core.observation.channels import CHANNELS, channel_layout
from mapf_pz.core.observation.features import FEATURES
from mapf_pz.core.observation.inputs import ObservationInputs
from mapf_pz.core.observation.layers import ViewShape, make_view_shape
from mapf_pz.core.observation.observe import observe


class ObservationLayout:
    """How one agent's observation is laid out. Raises `ValueError` for a view larger than the map."""

    def __init__(self, config: EnvConfig, shape: tuple[int, int]) -> None:
        """Lay out `config`'s channels and features for maps of `shape` (H, W)."""
        if config.view_size[0] > shape[0] or config.view_size[1] > shape[1]:
            raise ValueError(f"view_size={config.view_size}: expected at most the map's size, {shape}")
        self._config = config
        self.num_actions = len(CardinalAction if config.action_model == "cardinal" else Action)
        self._lengths = [FEATURES[name].length(self.num_actions, config.num_last_actions) for name in config.features]
        self.num_planes = sum(CHANNELS[name].planes for name in config.channels)
        self._planes = channel_layout(config.channels)
        self.num_features = sum(self._lengths)

    @property
    def image_shape(self) -> tuple[int, int, int]:
        """(K, h, w)."""
        return (self.num_planes, *self._config.view_size)

    @property
    def needs_distances(self) -> bool:
        """Whether any channel or feature reads the cost to go."""
        declared = [CHANNELS[name] for name in self._config.channels] + [FEATURES[n] for n in self._config.features]
        return any(part.needs_distances for part in declared)

    def space(self) -> spaces.Space[Any]:
        """Return the space of one agent's observation: `Box (K, h, w)`, or `Dict(image, features)`."""
        low, high = (
            np.repeat(
                [getattr(CHANNELS[name], bound) for name in self._config.channels],
                [CHANNELS[name].planes for name in self._config.channels],
            )
            for bound in ("low", "high")
        )
        planes = [np.broadcast_to(bound[:, None, None], self.image_shape) for bound in (low, high)]
        image = spaces.Box(planes[0].astype(np.float32), planes[1].astype(np.float32), dtype=np.float32)
        if not self.num_features:
            return image
        return spaces.Dict(image=image, features=spaces.Box(-1, 1, (self.num_features,), np.float32))

    def view_shape(self) -> ViewShape:
        """Return the geometry of the view, as the kernels take it."""
        config = self._config
        row = config.view_size[0] - 1 if config.resolved_view == "front" else config.view_size[0] // 2
        return make_view_shape(config.view_size, row, config.resolved_frame == "egocentric", config.see_through_walls)

    def write(self, num_threads: int, inputs: ObservationInputs, image: Floats, features: Floats) -> None:
        """Fill `image` (B, N, K, h * w) and `features` (B, N, F), both float32, with what all agents observe."""
        observe(num_threads, inputs, self._planes, image)
        at = 0
        for name, length in zip(self._config.features, self._lengths, strict=True):
            FEATURES[name].write(num_threads, inputs, features, at)
            at += length
        if self._config.on_target == "finish":
            gone = ~inputs.state.agents["was_active"]
            image[gone] = 0
            features[gone] = 0
