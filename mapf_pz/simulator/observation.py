"""The layout of observations: shapes, Gymnasium spaces, and the geometry that kernels take.

An agent's own observation of one step is an image of `K` planes and `F` features. The whole observation is that of the
last `num_frames` steps, oldest first; in each, those of `num_neighbors` neighbors follow the agent's own.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import accumulate
from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces

from mapf_pz._internal.arrays import Bools, Floats
from mapf_pz.simulator.actions import Action, CardinalAction
from mapf_pz.simulator.config import EnvConfig
from mapf_pz.simulator.kernels.observation.channels import channel_of, image_planes
from mapf_pz.simulator.kernels.observation.features import FEATURES, feature_of
from mapf_pz.simulator.kernels.observation.inputs import ObservationInputs
from mapf_pz.simulator.kernels.observation.layers import ViewShape, make_view_shape


class UserPart(NamedTuple):
    """A channel or feature that is not built in, its place in the agent's own observation, and its bounds."""

    name: str
    in_image: bool
    at: slice
    low: float
    high: float


class ObservationLayout:
    """The layout of one agent's observation."""

    def __init__(self, config: EnvConfig) -> None:
        """Arrange the channels and features of `config`."""
        self._config = config
        self.num_actions = len(CardinalAction if config.action_model == "cardinal" else Action)
        self.channels = tuple(map(channel_of, config.channels))
        self.features = tuple(map(feature_of, config.features))
        self.feature_sizes = tuple(feature.size(self.num_actions, config.num_last_actions) for feature in self.features)
        """How many numbers each feature is."""
        self._user_parts = tuple(self._find_user_parts())
        self.planes = image_planes(self.channels)
        """Where each channel is drawn in the agent's own image."""
        self.num_own_planes = sum(channel.planes for channel in self.channels)
        """K, the planes of the agent's own observation."""
        self.num_own_features = sum(self.feature_sizes)
        """F, the features of the agent's own observation."""
        self.num_features = config.num_frames * (1 + config.num_neighbors) * self.num_own_features
        """Number of features of the whole observation."""

    def _find_user_parts(self) -> Iterator[UserPart]:
        ends = accumulate(channel.planes for channel in self.channels)
        for channel, end in zip(self.channels, ends, strict=True):
            if channel.draw is not None:
                name = f"channel {getattr(channel.draw, '__name__', channel.draw)}"
                yield UserPart(name, True, slice(end - channel.planes, end), channel.low, channel.high)
        for feature, size, end in zip(self.features, self.feature_sizes, accumulate(self.feature_sizes), strict=True):
            if feature not in FEATURES.values():
                name = f"feature {getattr(feature.write, '__name__', feature.write)}"
                yield UserPart(name, False, slice(end - size, end), -1, 1)

    @property
    def image_shape(self) -> tuple[int, int, int]:
        """(num_frames * (1 + num_neighbors) * K, h, w), the shape of the whole image."""
        config = self._config
        height, width = config.view_size
        return config.num_frames * (1 + config.num_neighbors) * self.num_own_planes, height, width

    @property
    def own_planes(self) -> slice:
        """The planes of the whole image that are the agent's own of the current step."""
        return self._own(self.num_own_planes)

    @property
    def own_features(self) -> slice:
        """The features of the whole observation that are the agent's own of the current step."""
        return self._own(self.num_own_features)

    def own_feature(self, name: str) -> slice | None:
        """Return where the feature `name` of the agent itself and of the current step is in the whole observation.

        None: it is not observed.
        """
        if name not in self._config.features:
            return None
        k = self._config.features.index(name)
        start = self.own_features.start + sum(self.feature_sizes[:k])
        return slice(start, start + self.feature_sizes[k])

    @property
    def feature_names(self) -> tuple[str, ...]:
        """(F,) names of the agent's own features, numbered if a feature has several numbers."""
        return _numbered(self._config.features, self.feature_sizes, "feature")

    @property
    def plane_names(self) -> tuple[str, ...]:
        """(K,) names of the planes of the agent's own image, numbered if a channel has several planes."""
        return _numbered(self._config.channels, [channel.planes for channel in self.channels], "channel")

    def _own(self, size: int) -> slice:
        """Return where the last of the observed steps begins with `size` planes or features of the agent's own."""
        first = (self._config.num_frames - 1) * (1 + self._config.num_neighbors) * size
        return slice(first, first + size)

    @property
    def needs_cost_to_go(self) -> bool:
        """Whether any channel or feature reads the cost to go."""
        return any(part.needs_cost_to_go for part in (*self.channels, *self.features))

    @property
    def shows_edges(self) -> bool:
        """Whether any channel shows the weights of edges."""
        return self.planes.layers.edges_at >= 0

    def space(self) -> spaces.Space[Any]:
        """Return the space of one agent's whole observation: a `Box` for the image, or `Dict(image, features)`."""
        planes = [channel.planes for channel in self.channels]
        low = np.repeat([channel.low for channel in self.channels], planes)
        high = np.repeat([channel.high for channel in self.channels], planes)
        lows, highs = self._stacked(low, np.minimum(low, 0)), self._stacked(high, np.maximum(high, 0))
        image = spaces.Box(lows, highs, dtype=np.float32)
        # The bounds are the same in all cells of a plane; Gymnasium would print each of them.
        image.low_repr, image.high_repr = (
            f"[{' '.join(f'{bound:g}' for bound in box[:, 0, 0])}]" for box in (lows, highs)
        )
        if not self.num_features:
            return image
        return spaces.Dict(image=image, features=spaces.Box(-1, 1, (self.num_features,), np.float32))

    def _stacked(self, own: Floats, neighbor: Floats) -> Floats:
        """Return a bound of the whole image, from the bounds (K,) of the agent's own planes and of a neighbor's."""
        config = self._config
        bound = np.tile(np.concatenate([own, np.tile(neighbor, config.num_neighbors)]), config.num_frames)
        return np.broadcast_to(bound[:, None, None], self.image_shape).astype(np.float32)

    def view_shape(self) -> ViewShape:
        """Return the geometry of the view, as the kernels take it."""
        config = self._config
        height, width = config.view_size
        row = height - 1 if config.resolved_view == "front" else height // 2
        return make_view_shape((height, width), row, config.resolved_frame == "egocentric", config.see_through_walls)

    def write_features(self, inputs: ObservationInputs, features: Floats) -> None:
        """Fill `features` (B, N, F) float32 with all agents' own features."""
        at = 0
        for feature, size in zip(self.features, self.feature_sizes, strict=True):
            feature.write(inputs, features, at)
            at += size

    def check_user_parts(self, image: Floats, features: Floats, active: Bools) -> None:
        """Check that channels and features of users are within their bounds.

        Args:
            image: (B, N, K, h, w) float32: all agents' own images.
            features: (B, N, F) float32: all agents' own features.
            active: (B, N) bool: False for agents that have disappeared, which are not checked.

        Raises `ValueError` for a number outside of the bounds, or one that is not a number.
        """
        for part in self._user_parts:
            values = image[:, :, part.at][active] if part.in_image else features[:, :, part.at][active]
            if not ((values >= part.low) & (values <= part.high)).all():
                expected = f"numbers from {part.low:g} to {part.high:g}"
                raise ValueError(f"{part.name}: expected {expected}, got {values.min():g} to {values.max():g}")


def _numbered(parts: Sequence[object], sizes: Sequence[int], unnamed: str) -> tuple[str, ...]:
    """Return a name for each number of some parts, such as `goal`, or `last 1` and `last 2` for a part of size 2."""
    names: list[str] = []
    for part, size in zip(parts, sizes, strict=True):
        name = part if isinstance(part, str) else unnamed
        names += [name] if size == 1 else [f"{name} {k + 1}" for k in range(size)]
    return tuple(names)
