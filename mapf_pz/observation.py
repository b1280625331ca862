"""The layout of observations: shapes, Gymnasium spaces, and the geometry that kernels take."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces

from mapf_pz.actions import Action, CardinalAction
from mapf_pz.arrays import Floats
from mapf_pz.config import EnvConfig
from mapf_pz.core.observation.channels import channel_of, layer_planes
from mapf_pz.core.observation.features import feature_of
from mapf_pz.core.observation.inputs import ObservationInputs
from mapf_pz.core.observation.layers import EDGES, ViewShape, make_view_shape
from mapf_pz.core.observation.observe import observe


class ObservationLayout:
    """The layout of one agent's observation. Raises `ValueError` for a view larger than the map."""

    def __init__(self, config: EnvConfig, shape: tuple[int, int]) -> None:
        """Arrange the channels and features of `config` for maps of `shape` (H, W)."""
        if config.view_size[0] > shape[0] or config.view_size[1] > shape[1]:
            raise ValueError(f"view_size={config.view_size}: expected at most the map's size, {shape}")
        self._config = config
        self.num_actions = len(CardinalAction if config.action_model == "cardinal" else Action)
        self.channels = tuple(map(channel_of, config.channels))
        self.features = tuple(map(feature_of, config.features))
        self._sizes = [feature.size(self.num_actions, config.num_last_actions) for feature in self.features]
        self._layer_planes = layer_planes(self.channels)
        self.num_planes = sum(channel.planes for channel in self.channels)
        self.num_features = sum(self._sizes)

    @property
    def image_shape(self) -> tuple[int, int, int]:
        """(K, h, w)."""
        return (self.num_planes, *self._config.view_size)

    @property
    def needs_cost_to_go(self) -> bool:
        """Whether any channel or feature reads the cost to go."""
        return any(part.needs_cost_to_go for part in (*self.channels, *self.features))

    @property
    def shows_edges(self) -> bool:
        """Whether any channel shows the weights of edges."""
        return bool((self._layer_planes.shown >= EDGES[0]).any())

    def space(self) -> spaces.Space[Any]:
        """Return the space of one agent's observation: `Box (K, h, w)`, or `Dict(image, features)`."""
        low, high = (
            np.repeat([getattr(channel, bound) for channel in self.channels], [c.planes for c in self.channels])
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

    def write(self, inputs: ObservationInputs, image: Floats, features: Floats) -> None:
        """Fill `image` (B, N, K, h, w) and `features` (B, N, F), both float32, with what all agents observe."""
        observe(inputs, self.channels, self._layer_planes, image)
        at = 0
        for feature, size in zip(self.features, self._sizes, strict=True):
            feature.write(inputs, features, at)
            at += size
        if self._config.on_target == "finish":
            gone = ~inputs.state.agents["was_active"]
            image[gone] = 0
            features[gone] = 0
